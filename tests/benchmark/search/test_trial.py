from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from benchmark import registry
from benchmark.curves import load_curve
from benchmark.interface import Clip
from benchmark.model_spec import ModelSpec
from benchmark.search.plan import make_trials
from benchmark.search.trial import Outcome, Trial, load_outcomes, observation_loss, save_outcome
from benchmark.tracks import DataFolder
from datagen.errors import CorruptFile, DatagenError
from tests.fabricated import write_dataset

CURVE = [{"step": 1, "seconds": 2.0, "loss": 8.0}, {"step": 9, "seconds": 4.0, "loss": 5.0, "surface loss": 2.0}]


class Learner:
    """Says what it was told."""

    told: dict[str, Any]

    def __init__(self, options: Mapping[str, Any], curve: list[dict[str, float]] | None):
        self.told, self.learning_curve = dict(options), curve

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        self.told |= {"clips": (len(train), len(val)), "seed": seed, "budget": budget}
        assert all(clip.truth is None for clip in (*train, *val))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("trials") / "data", scenes=2, frames=1)


def trials(data: Path, out: Path, curve: list[dict[str, float]] | None, monkeypatch: pytest.MonkeyPatch) -> Any:
    models: list[Learner] = []

    def build(options: Mapping[str, Any]) -> Learner:
        models.append(Learner(options, curve))
        return models[-1]

    spec = ModelSpec(build, 1, "", trials=({}, {"rate": 2.0}))  # type: ignore[arg-type]
    monkeypatch.setitem(registry.MODELS, "net", spec)
    return make_trials(["net"], [DataFolder(data)], seconds=60.0, out=out), models


def test_a_trial_trains_without_labels_and_leaves_its_last_losses(data: Path, tmp_path: Path, monkeypatch):
    (_, trial), models = trials(data, tmp_path, CURVE, monkeypatch)
    heard: list[str] = []
    trial.run(heard.append)
    assert heard == [trial.name]
    (model,) = models
    assert model.told.pop("folder").parent == tmp_path / "training"
    assert model.told == {"slots": 5, "changes": {"rate": 2.0}, "clips": (2, 2), "seed": 0, "budget": 60.0}
    (outcome,) = load_outcomes(tmp_path)
    assert outcome == Outcome(trial.name, "net", 1, {"rate": 2.0}, "data", 9, 4.0, 2.0)
    assert load_curve(tmp_path / "curves" / f"{trial.name}.csv") == CURVE


@pytest.mark.parametrize("curve", [None, [], [{"step": 1.0}], [{"loss": float("nan")}]])
def test_a_model_without_losses_gives_no_outcome(data: Path, tmp_path: Path, monkeypatch, curve):
    (trial, _), _ = trials(data, tmp_path, curve, monkeypatch)
    with pytest.raises(DatagenError, match="'net' has no finite loss on validation clips"):
        trial.run(lambda event: None)
    assert load_outcomes(tmp_path) == []


def test_what_explains_the_images_decides_and_not_what_shapes_the_masks():
    point = {"loss": 100.0, "colour loss": 1.0, "surface loss": 2.0, "air loss": 4.0, "mask loss": 50.0, "kl loss": 9.0}
    assert observation_loss(point) == 7.0


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"name": "', '"name": "../../../'),
        ('"trial": 0', '"trial": "0"'),
        ('"trial": 0', '"trial": -1'),
        ('"steps": 0', '"steps": NaN'),
        ('"reason": "lost"', '"reason": null'),
        ('"reason": "lost"', '"other": "lost"'),
        ('"changes": {}', '"changes": []'),
        ('"validation_loss": null', '"validation_loss": Infinity'),
        ('"validation_loss": null', '"validation_loss": "x"'),
    ],
)
def test_a_damaged_outcome_is_named(data: Path, tmp_path: Path, monkeypatch, old: str, new: str):
    """Its name becomes that of a file which --retry deletes."""
    (trial, _), _ = trials(data, tmp_path, CURVE, monkeypatch)
    assert isinstance(trial, Trial)
    save_outcome(tmp_path, Outcome.of(trial, reason="lost"))
    (path,) = (tmp_path / "trials").iterdir()
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(CorruptFile, match=rf"{path.name} is damaged"):
        load_outcomes(tmp_path)


def test_failed_outcomes_are_read_as_they_were_written(data: Path, tmp_path: Path, monkeypatch):
    (trial, _), _ = trials(data, tmp_path, CURVE, monkeypatch)
    assert isinstance(trial, Trial)
    save_outcome(tmp_path, Outcome.of(trial, reason="lost"))
    (outcome,) = load_outcomes(tmp_path)
    assert (outcome.reason, outcome.steps) == ("lost", 0)
    assert outcome.validation_loss != outcome.validation_loss
    (path,) = (tmp_path / "trials").iterdir()
    path.write_text("{")
    with pytest.raises(CorruptFile, match="delete it and run the same command again"):
        load_outcomes(tmp_path)
