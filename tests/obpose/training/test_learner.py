from typing import Any

import pytest
import torch
from torch import Tensor

from obpose.data.clips import stack
from obpose.storage.checkpoint import TrainingState
from obpose.training.devices import make_fabric
from obpose.training.learner import Learner
from obpose.types import Observation
from tests.obpose.toy import QuietToy, ToyClips, ToyModel, toy_config


def learner(build: type[ToyModel] = ToyModel, **changes: object) -> Learner:
    config = toy_config(**changes)
    return Learner(make_fabric("cpu", config.train), config, build)


@pytest.fixture
def batch() -> dict[str, Tensor]:
    return stack([ToyClips().window(index, 0, 2) for index in (0, 1)])


def test_a_step_follows_the_gradient(batch: dict[str, Tensor]):
    made = learner()
    before = made.model.state_dict()["mean"].clone()
    first = made.step(batch, step=0, fraction=0.5, learning_rate=0.01)
    change = made.model.state_dict()["mean"] - before
    torch.testing.assert_close(change.abs(), torch.full((3,), 0.01), rtol=1e-3, atol=0)  # Adam's first step
    assert made.step(batch, step=0, fraction=0.5, learning_rate=0.01).losses["total"] < first.losses["total"]


def test_a_learning_rate_of_zero_changes_nothing(batch: dict[str, Tensor]):
    made = learner()
    before = {name: value.clone() for name, value in made.weights().items()}
    made.step(batch, step=4, fraction=0.5, learning_rate=0.0)
    assert all(torch.equal(value, before[name]) for name, value in made.weights().items())


def test_noise_belongs_to_the_step(batch: dict[str, Tensor]):
    made = learner()
    one, other, again = (made.step(batch, step=step, fraction=0.5, learning_rate=0.0).losses for step in (4, 5, 4))
    assert one == again
    assert one != other


def test_the_norm_is_measured_before_clipping_and_without_it(batch: dict[str, Tensor]):
    norms = []
    for clip in (0.0, 1e-6):
        made = learner(**{"train.clip": clip})
        norms.append(made.step(batch, step=4, fraction=0.5, learning_rate=0.0).gradient_norm)
        left = torch.stack([p.grad.norm() for p in made.model.parameters() if p.grad is not None]).norm()
        assert float(left) == pytest.approx(norms[0] if clip == 0.0 else 1e-6, rel=1e-3)
    assert norms[0] == norms[1]


def test_state_is_taken_over_exactly(batch: dict[str, Tensor]):
    one = learner(QuietToy)
    for step in range(4):
        one.step(batch, step=step, fraction=0.5, learning_rate=0.01)
    copies = ({name: value.clone() for name, value in part.items()} for part in (one.weights(), one.optimizer_state()))
    other = learner(QuietToy, **{"train.seed": 7})
    other.restore(TrainingState(*copies, {}))
    for made in (one, other):
        made.step(batch, step=5, fraction=0.5, learning_rate=0.01)
    assert all(torch.equal(value, other.weights()[name]) for name, value in one.weights().items())


def test_parameters_without_a_gradient_yet_have_no_state(batch: dict[str, Tensor]):
    made = learner()
    made.step(batch, step=0, fraction=0.5, learning_rate=0.01)  # warm-up
    assert {name.rpartition(".")[0] for name in made.optimizer_state()} == {"mean"}


@pytest.mark.parametrize(("views", "clips"), [("all", 1), ("separate", 3)])
def test_separate_views_are_as_many_clips(views: str, clips: int):
    seen: list[int] = []

    class Counting(ToyModel):
        def losses(self, observation: Observation, **step: Any) -> dict[str, Tensor]:
            seen.append(len(observation.depth))
            return super().losses(observation, **step)

    made = learner(Counting, **{"train.views": views})
    made.step(stack([ToyClips(views=3).window(0, 0, 2)]), step=0, fraction=0.0, learning_rate=0.0)
    assert seen == [clips]
