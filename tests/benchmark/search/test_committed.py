"""The search whose table is committed is the one that the code declares, and what it chose is what is used.

The table does not say with which budget, dataset and other settings the trials ran; docs/results/search.md does.
"""

import csv
import json

import pytest

from benchmark.adapters.trials import TRIALS
from benchmark.registry import MODELS
from benchmark.search.choice import choices
from benchmark.search.table import SEARCH
from benchmark.search.trial import Outcome
from obpose.systems import find_system
from tests.small import ROOT

TRACKS = ("moving", "clevr3d")
SYSTEMS = sorted(TRIALS)

with (ROOT / "docs" / "search" / SEARCH).open(newline="") as _file:
    LINES = list(csv.DictReader(_file))

OUTCOMES = [
    Outcome(
        name="",
        model=line["system"],
        trial=int(line["trial"]),
        changes=json.loads(line["changes"]),
        track=line["track"],
        steps=int(line["steps"]),
        seconds=float(line["seconds"]),
        validation_loss=float(line["validation_loss"]),
        reason=line["failure"],
    )
    for line in LINES
]


@pytest.mark.parametrize("system", SYSTEMS)
def test_no_trial_is_missing_and_none_failed(system: str):
    spec = MODELS[system]
    declared = {
        (number, track): {**spec.on_tracks.get(track, {}), **changes}
        for number, changes in enumerate(spec.trials)
        for track in TRACKS
    }
    found = [outcome for outcome in OUTCOMES if outcome.model == system]
    assert {(outcome.trial, outcome.track): outcome.changes for outcome in found} == declared
    assert len(found) == len(declared)
    assert not any(outcome.reason for outcome in found)


def test_no_other_system_is_in_the_table():
    assert {outcome.model for outcome in OUTCOMES} == set(SYSTEMS)


def test_the_table_says_what_the_rule_chooses():
    assert choices(OUTCOMES) == {line["system"]: int(line["trial"]) for line in LINES if line["chosen"] == "yes"}


@pytest.mark.parametrize("system", SYSTEMS)
def test_what_was_chosen_is_what_is_used(system: str):
    chosen = choices(OUTCOMES)[system]
    spec = MODELS[system]
    found = find_system(system)
    assert found.config() == found.config(changes={**spec.searched_from, **spec.trials[chosen]})
