from collections.abc import Sequence

import pytest

from benchmark.models.interface import Clip, Prediction
from benchmark.models.model_spec import Builder, ModelSpec, Views


class Plain:
    """Finds the number of objects itself."""

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        pass

    def segment(self, clip: Clip) -> Prediction:
        raise NotImplementedError


class Told(Plain):
    """Is told it."""

    def __init__(self, slots: int, profile: str = "cpu"):
        self.slots, self.profile = slots, profile


@pytest.mark.parametrize(
    ("views", "number", "words"),
    [
        (Views("one", "all"), 3, "1 in, 3 supervise"),
        (Views("all", "all"), 3, "3 in, 3 supervise"),
        (Views("one", "one"), 2, "1 in, 1 supervise"),
        (Views("one", "all"), 1, ""),
    ],
)
def test_views_are_those_of_the_track(views: Views, number: int, words: str):
    assert views.on(number) == words


def test_constants_of_a_profile_are_the_usual_ones_unless_said():
    spec = ModelSpec(Builder(Told), 1, "", settings={"width": 1}, profiles={"gpu": {"width": 2}})
    assert (spec.settings_in("cpu"), spec.settings_in("gpu")) == ({"width": 1}, {"width": 2})
    assert ModelSpec(Builder(Told), 1, "", settings={"width": 1}).settings_in("gpu") == {"width": 1}


def test_options_go_to_those_who_take_them():
    offered = {"slots": 4, "profile": "gpu", "folder": None, "changes": {}}
    assert vars(Builder(Told)(offered)) == {"slots": 4, "profile": "gpu"}
    assert isinstance(Builder(Plain)(offered), Plain)
    assert ModelSpec(Builder(Told), 1, "").takes_slots
    assert not ModelSpec(Builder(Plain), 1, "").takes_slots
    assert ModelSpec(lambda options: Told(**options), 1, "").takes_slots
