"""Checks that losses and gradients are finite, before they change the weights."""

import math
from collections.abc import Iterable, Mapping

from torch import nn

from obpose.errors import Diverged

_NAMED = 3
"""Largest number of parameters named in a message."""
_ADVICE = (
    "Try half the learning rate (--set train.learning_rate=...), --set train.clip=1, another --seed, or look for clips "
    "with depths or poses that are not finite."
)


def check_finite(
    losses: Mapping[str, float], gradient_norm: float, parameters: Iterable[tuple[str, nn.Parameter]], *, step: int
) -> None:
    """Check the losses and gradients of a step.

    Raises:
        Diverged: some are not finite; the message names the terms or parameters, and what to try.
    """
    if math.isfinite(losses["total"]) and math.isfinite(gradient_norm):
        return
    terms = [f"{name} is {value}" for name, value in losses.items() if not math.isfinite(value) and name != "total"]
    if not terms and not math.isfinite(losses["total"]):
        terms = [f"the weighted sum is {losses['total']} though no term is"]
    cause = f"among the losses {', '.join(terms)}" if terms else _gradients(parameters)
    raise Diverged(
        f"Training diverged in step {step}: {cause}. The weights are those before this step, and the last checkpoint "
        f"is kept. {_ADVICE}"
    )


def check_validation(losses: Mapping[str, float], *, step: int) -> None:
    """Check the losses on validation clips, because the last step may have spoiled the weights.

    Raises:
        Diverged: some are not finite; the message names the terms, and what to try.
    """
    if math.isfinite(losses["total"]):
        return
    wrong = [f"{name} is {value}" for name, value in losses.items() if not math.isfinite(value)]
    raise Diverged(
        f"Training diverged by step {step}: among the losses on validation clips {', '.join(wrong)}. The last "
        f"checkpoint is kept. {_ADVICE}"
    )


def _gradients(parameters: Iterable[tuple[str, nn.Parameter]]) -> str:
    grads = {name: parameter.grad for name, parameter in parameters}
    wrong = [name for name, grad in grads.items() if grad is not None and not grad.isfinite().all()]
    if not wrong:
        return "the losses are finite, but not the norm of the gradients"
    more = f" and {len(wrong) - _NAMED} more" if len(wrong) > _NAMED else ""
    return f"the losses are finite, but not the gradients of {', '.join(wrong[:_NAMED])}{more}"
