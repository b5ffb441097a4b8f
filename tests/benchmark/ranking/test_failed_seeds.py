import math

import pytest

from benchmark.ranking.failed_seeds import cause_of_failure, has_finite_loss
from tests.chosen_scores import run_row


@pytest.mark.parametrize(
    ("miou_bg", "msc_fg", "best_floor", "cause"),
    [
        (0.95, 0.80, 0.15, ""),
        (0.49, 0.80, 0.15, "swap"),
        (0.50, 0.80, 0.15, ""),
        (0.95, 0.19, 0.15, "collapse"),
        (0.95, 0.05, 0.15, "collapse"),
        (0.95, 0.20, 0.15, "collapse"),
        (0.95, 0.21, 0.15, ""),
        (0.10, 0.05, 0.15, "swap"),
        (0.95, 0.05, math.nan, ""),
        (math.nan, 0.80, 0.15, ""),
    ],
)
def test_the_rule(miou_bg: float, msc_fg: float, best_floor: float, cause: str):
    assert cause_of_failure(miou_bg, msc_fg, best_floor) == cause


def test_nan_comes_first():
    assert cause_of_failure(0.1, 0.1, 0.2, finite=False) == "nan"


def test_the_loss_is_read_from_the_learning_curve():
    curve = [{"step": 1.0, "loss": 2.0, "val_msc_fg": math.nan}, {"step": 2.0, "loss": 1.0}]
    assert has_finite_loss(run_row(learning_curve=curve))
    assert not has_finite_loss(run_row(learning_curve=[*curve, {"step": 3.0, "val_loss": math.nan}]))
    assert has_finite_loss(run_row(learning_curve=None))
