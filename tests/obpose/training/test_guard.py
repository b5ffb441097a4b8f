import math

import pytest
import torch
from torch import nn

from obpose.errors import Diverged
from obpose.training.guard import check_finite, check_validation

NAN, INF = math.nan, math.inf


def parameters(*gradients: float | None) -> list[tuple[str, nn.Parameter]]:
    found = []
    for number, gradient in enumerate(gradients):
        parameter = nn.Parameter(torch.zeros(2))
        parameter.grad = None if gradient is None else torch.tensor([0.0, gradient])
        found.append((f"p{number}", parameter))
    return found


def test_finite_numbers_pass():
    check_finite({"total": 1.0, "air": -3.0}, 2.0, parameters(1.0, None), step=4)


def test_a_term_outside_the_sum_may_be_anything():
    check_finite({"total": 1.0, "air": INF}, 2.0, parameters(1.0), step=4)


@pytest.mark.parametrize(
    ("losses", "norm", "gradients", "message"),
    [
        ({"total": NAN, "air": NAN, "scope": 1.0}, NAN, [NAN], "step 4: among the losses air is nan"),
        ({"total": INF, "air": 1.0, "scope": INF}, 1.0, [1.0], "among the losses scope is inf"),
        ({"total": INF, "air": 1.0}, 1.0, [1.0], "the weighted sum is inf though no term is"),
        ({"total": 1.0, "air": 1.0}, NAN, [1.0, INF, None, NAN], r"not the gradients of p1, p3\."),
        ({"total": 1.0}, INF, [1.0], "not the norm of the gradients"),
        ({"total": 1.0}, INF, [NAN] * 5, "not the gradients of p0, p1, p2 and 2 more"),
    ],
)
def test_the_cause_is_named(losses: dict[str, float], norm: float, gradients: list[float | None], message: str):
    with pytest.raises(Diverged, match=message) as raised:
        check_finite(losses, norm, parameters(*gradients), step=4)
    assert "--set train.learning_rate" in str(raised.value)


def test_a_loss_on_validation_clips_that_is_not_finite_is_named():
    check_validation({"total": 1.0, "air": INF}, step=7)
    with pytest.raises(Diverged, match=r"by step 7: .* on validation clips air is nan, total is inf"):
        check_validation({"air": NAN, "total": INF, "scope": 1.0}, step=7)
