"""The search whose outcomes are committed is the one that the code declares, and what it chose is what is used."""

from functools import cache

import pytest

from benchmark.adapters.trials import TRIALS
from benchmark.registry import MODELS
from benchmark.search.choice import choices
from benchmark.search.plan import make_trials, missing
from benchmark.search.trial import load_outcomes
from benchmark.tracks import find_track
from obpose.systems import find_system
from tests.small import ROOT

SEARCH = ROOT / "docs" / "search"
TRACKS = ("moving", "clevr3d")


@cache
def outcomes():
    return tuple(load_outcomes(SEARCH))


SYSTEMS = sorted(TRIALS)


@pytest.mark.parametrize("system", SYSTEMS)
def test_no_trial_is_missing_and_none_failed(system: str):
    trials = make_trials([system], [find_track(name) for name in TRACKS], seconds=180.0, out=SEARCH)
    assert len(trials) == len(TRACKS) * len(MODELS[system].trials)
    assert missing(trials, outcomes()) == []
    assert not any(outcome.reason for outcome in outcomes() if outcome.model == system)


@pytest.mark.parametrize("system", SYSTEMS)
def test_what_was_chosen_is_what_is_used(system: str):
    chosen = choices(outcomes())[system]
    spec = MODELS[system]
    found = find_system(system)
    assert found.config() == found.config(changes={**spec.searched_from, **spec.trials[chosen]})
