import math

import numpy as np
import pytest

from benchmark.search.choice import best_trial, choices, mean_ranks, standardised
from benchmark.search.trial import Outcome

NAN = math.nan


def outcome(model: str, trial: int, track: str, loss: float) -> Outcome:
    return Outcome("", model, trial, {}, track, 1, 1.0, loss)


@pytest.mark.parametrize(
    ("losses", "best"),
    [
        ([[3.0], [1.0], [2.0]], 1),
        ([[2.0, 400.0], [1.0, 600.0], [1.5, 300.0]], 2),
        ([[1.0, 2.0], [2.0, 1.0]], 0),
        ([[1.0, 9.0], [2.0, 1.0], [3.0, 2.0]], 1),
        ([[0.0, NAN], [5.0, 5.0]], 1),
        ([[NAN, 1.0], [1.0, NAN]], None),
    ],
)
def test_the_best_mean_rank_over_tracks_is_chosen_and_a_failed_trial_never(losses: list[list[float]], best: int | None):
    assert best_trial(np.array(losses)) == best


def test_units_of_a_track_do_not_matter():
    losses = np.random.default_rng(0).normal(size=(4, 3))
    moved = losses * [1.0, 1e3, 1e-3] + [0.0, -50.0, 7.0]
    assert best_trial(moved) == best_trial(losses)
    np.testing.assert_allclose(standardised(moved), standardised(losses))
    np.testing.assert_array_equal(mean_ranks(moved), mean_ranks(losses))


def test_equal_ranks_are_told_apart_by_how_far_losses_lie():
    losses = np.array([[1.0, 5.0], [1.1, 1.0], [9.0, 9.0]])
    assert mean_ranks(losses)[0] == mean_ranks(losses)[1]
    assert best_trial(losses) == 1


def test_each_system_has_a_choice_of_its_own():
    outcomes = [
        outcome("one", 0, "moving", 1.0),
        outcome("one", 1, "moving", 2.0),
        outcome("two", 0, "moving", 2.0),
        outcome("two", 1, "moving", 1.0),
        outcome("lost", 0, "moving", NAN),
    ]
    assert choices(outcomes) == {"one": 0, "two": 1}


def test_a_trial_that_was_not_made_on_every_track_is_not_chosen():
    outcomes = [outcome("one", 0, "moving", 1.0), outcome("one", 1, "moving", 2.0), outcome("one", 1, "static", 2.0)]
    assert choices(outcomes) == {"one": 1}
