import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmark import registry
from benchmark.model_spec import ModelSpec
from benchmark.search.plan import make_trials, missing
from benchmark.search.trial import Outcome, Trial
from benchmark.tracks import find_track
from datagen.errors import UsageError

TRIALS = ({}, {"rate": 1.0}, {"rate": 2.0})


@pytest.fixture(autouse=True)
def register(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    def never(options: object) -> None:
        raise AssertionError

    def add(**facts: object) -> None:
        monkeypatch.setitem(registry.MODELS, "net", ModelSpec(never, 1, "", **{"trials": TRIALS, **facts}))  # type: ignore[arg-type]

    add()
    return add


def made(*tracks: str, **facts: object) -> list[Trial]:
    sources = [find_track(name) for name in tracks or ("moving",)]
    return make_trials(["net"], sources, **{"seconds": 180.0, "out": Path("out"), **facts})  # type: ignore[arg-type]


def test_every_trial_is_made_on_every_track():
    found = [(trial.track, trial.number, trial.changes, trial.seconds) for trial in made("moving", "clevr3d")]
    assert found == [(track, i, TRIALS[i], 180.0) for track in ("moving", "clevr3d") for i in range(3)]
    assert {trial.slots for trial in made("clevr3d")} == {7}


def test_a_model_that_declares_nothing_has_one_trial_which_changes_nothing(register):
    register(trials=ModelSpec.trials)
    assert [trial.changes for trial in made()] == [{}]


def test_steps_stand_in_for_seconds():
    (first, *_) = made(steps=7)
    assert (first.seconds, first.steps) == (float("inf"), 7)


def test_trials_of_other_settings_never_mix(register):
    names = {made(**facts)[0].name for facts in ({}, {"seconds": 60.0}, {"steps": 6}, {"profile": "gpu"})}
    register(settings={"width": 2})
    names.add(made()[0].name)
    assert len(names) == 5


def test_a_declaration_that_changed_makes_another_trial(register):
    before = [trial.name for trial in made()]
    register(trials=({}, {"rate": 9.0}, {"rate": 2.0}))
    assert [name in before for name in (trial.name for trial in made())] == [True, False, True]


def test_freezing_a_choice_leaves_its_trials_what_they_were(register):
    register(settings={"net": {"rate": 5.0, "width": 2}})
    before = [(trial.name, trial.changes) for trial in made()]
    register(settings={"net": {"rate": 1.0, "width": 2}}, searched_from={"net.rate": 5.0})
    assert [(trial.name, trial.changes) for trial in made()] == before
    assert [trial.options["changes"] for trial in made()] == [{"net.rate": 5.0, **changes} for changes in TRIALS]
    register(settings={"net": {"rate": 1.0, "width": 2}})
    assert not {trial.name for trial in made()} & {name for name, _ in before}


def test_what_is_there_is_not_made_again():
    trials = made()
    for there in (Outcome.of(trials[1], validation_loss=1.0), Outcome.of(trials[1], reason="it diverged")):
        assert missing(trials, [there]) == [trials[0], trials[2]]


def test_an_outcome_of_other_settings_is_not_replaced():
    old = Outcome.of(dataclasses.replace(made()[0], digest="0" * 64))
    with pytest.raises(UsageError, match="out has trial 0 of net on moving with another budget"):
        missing(made(), [old])


@pytest.mark.parametrize(
    ("facts", "reason"), [({"kind": "classical"}, "learns nothing"), ({"uses_labels": True}, "learns from labels")]
)
def test_what_cannot_be_searched_is_refused(register, facts: dict[str, object], reason: str):
    register(**facts)
    with pytest.raises(UsageError, match=reason):
        made()
