"""What the benchmark knows of a model besides the model itself."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from benchmark.interface import Segmenter

Options = Mapping[str, Any]
"""Keyword arguments of a model's constructor: numbers, strings, booleans."""

Kind = Literal["floor", "classical", "oracle", "learned", "predictions"]
KINDS: tuple[str, ...] = get_args(Kind)

PRIORS = ("slots", "background slot", "camera pose", "plane")
"""Number of slots; which slot is the background; poses of the cameras; that the background is a plane."""

DEFAULT_BUDGET = 600.0
"""Seconds of one core that a model may train for, if it does not say otherwise."""


@dataclass(frozen=True)
class ModelSpec:
    """One model that can be named on the command line."""

    build: Callable[[Options], Segmenter]
    """Makes a model from one value of its grid and the options on offer; see `benchmark.interface`."""
    version: int
    """Rises when the model's results change."""
    description: str
    kind: Kind = "learned"
    grid: tuple[Options, ...] = ()
    """Declared values to tune over, the first being the default; empty if nothing is tuned."""
    random: bool = True
    """Whether another seed gives other results; if not, it is run once."""
    uses_labels: bool = False
    """Whether its clips carry `truth`."""
    priors: tuple[str, ...] = ()
    """What it is told beyond the images, out of `PRIORS`."""
    budget: float = DEFAULT_BUDGET
    """Seconds of one core that it trains for unless the command says otherwise."""
    extra: tuple[str, ...] = ()
    """Names of the segmentations in `Prediction.extra`, which have rows of their own."""
    settled_with_labels: bool = False
    """Whether its constants were chosen by scores on labelled validation scenes; rows are marked like tuned ones."""
    settings: Options = field(default_factory=dict)
    """Constants that its results depend on beside its version and options; rows are made anew when they change."""

    @property
    def default(self) -> Options:
        """The first value of the grid."""
        return self.grid[0] if self.grid else {}


OFFERED = ("slots", "steps", "folder", "checkpoint")
"""Options that every model is offered, and gets if its constructor has an argument of that name; see
`benchmark.interface`."""


def builder(model: Callable[..., Segmenter]) -> Callable[[Options], Segmenter]:
    """Calls a class with the options as keyword arguments; with `OFFERED` ones only if its constructor has them."""
    refused = {name for name in OFFERED if name not in inspect.signature(model).parameters}

    def build(options: Options) -> Segmenter:
        return model(**{name: value for name, value in options.items() if name not in refused})

    return build
