from collections.abc import Callable, Sequence
from pathlib import Path

import jaxtyping
import numpy as np
import pytest
from fabricated import write_dataset

from benchmark import registry
from benchmark.interface import Clip, Prediction
from benchmark.runner import BadPrediction, background_slot, run
from datagen import storage
from datagen.errors import UsageError

Answer = Callable[[Clip], Prediction]


class Scripted:
    """A model that answers as it is told, and remembers what it was given."""

    def __init__(self, answer: Answer):
        self.answer = answer
        self.seed = -1
        self.clips = (0, 0)

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        self.seed, self.clips = seed, (len(train), len(val))

    def segment(self, clip: Clip) -> Prediction:
        return self.answer(clip)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "data", scenes=2, frames=3, views=2, sensor=True)


@pytest.fixture
def register(monkeypatch: pytest.MonkeyPatch) -> Callable[[Answer], Scripted]:
    def add(answer: Answer) -> Scripted:
        model = Scripted(answer)
        monkeypatch.setitem(registry.MODELS, "scripted", registry.ModelSpec(lambda: model, 3, ""))
        return model

    return add


def test_a_model_that_knows_the_truth_scores_one(data: Path, register):
    truths = iter([storage.Dataset(data).split("test")[i]["segmentation"] for i in range(2)])
    model = register(lambda clip: Prediction(next(truths).astype(np.int64), 0))
    done = []
    result = run("scripted", data, seed=4, progress=done.append)
    assert model.seed == 4
    assert model.clips == (2, 2)
    assert done == [1, 2]
    assert result.version == 3
    assert result.dataset == "spheres"
    assert result.spec_hash == storage.Dataset(data).spec["spec_hash"]
    assert result.scenes == 2
    assert result.scores["n_frames"] == 2 * 3 * 2
    assert all(result.scores[name] == 1 for name in ("ari", "ari_fg", "msc_fg", "miou_bg"))
    assert result.seconds_per_frame > 0


def test_pixels_without_depth_do_not_count(data: Path, register):
    scenes = storage.Dataset(data).split("test")
    truths = iter([scenes[i]["segmentation"] for i in range(2)])
    register(lambda clip: Prediction(np.where(clip.valid, next(truths), 9).astype(np.int64), 0))
    result = run("scripted", data, seed=0)
    assert result.scores["ari"] == result.scores["msc_fg"] == 1
    assert result.scores["n_ignored"] == sum(int(np.sum(scenes[i]["sensor_valid"] == 0)) for i in range(2))


def test_frames_are_pooled_over_scenes(data: Path, register):
    answers = iter([0, 1])
    truth = storage.Dataset(data).split("test")[0]["segmentation"].astype(np.int64)
    register(lambda clip: Prediction(truth if next(answers) == 0 else np.zeros_like(truth), 0))
    result = run("scripted", data, seed=0)
    assert result.scores["msc_fg"] == 0.5


def test_the_largest_slot_stands_in_for_an_undeclared_background():
    labels = np.array([[[[4, 4, 4, 0, 0, 2]]]])
    assert background_slot(Prediction(labels, None)) == 4
    assert background_slot(Prediction(labels, 2)) == 2


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda clip: Prediction(np.zeros(clip.depth.shape[1:], int), 0), "of shape"),
        (lambda clip: Prediction(np.full(clip.depth.shape, -1), 0), "label -1"),
        (lambda clip: Prediction(np.zeros(clip.depth.shape, int), -1), "background slot -1"),
    ],
)
def test_a_model_that_breaks_the_contract_is_named(data: Path, register, monkeypatch, answer: Answer, message: str):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    register(answer)
    with pytest.raises(BadPrediction, match=message):
        run("scripted", data, seed=0)


def test_an_empty_split_is_refused(tmp_path: Path):
    with pytest.raises(UsageError, match="has no scenes"):
        run("plane-dbscan", write_dataset(tmp_path / "data", scenes=0), seed=0)
