"""What the benchmark knows of a model besides the model itself."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from benchmark.models.interface import Segmenter
from datagen.tracks import Profile

Options = Mapping[str, Any]
"""Keyword arguments of a model's constructor: numbers, strings, booleans."""

Kind = Literal["floor", "classical", "oracle", "learned", "predictions"]
KINDS: tuple[str, ...] = get_args(Kind)

PRIORS = ("slots", "background slot", "camera pose", "plane", "object size")
"""Number of slots; which slot is the background; poses of the cameras; that the background is a plane; how large
objects are at most."""

DEFAULT_BUDGET = 600.0
"""Seconds of one core that a model may train for, if it does not say otherwise."""


ViewsSeen = Literal["one", "all"]
"""Of the views of a frame."""
VIEWS_SEEN: tuple[ViewsSeen, ...] = get_args(ViewsSeen)


@dataclass(frozen=True)
class Views:
    """How many views of a frame a model is given, and how many say in training what it should have rendered."""

    given: ViewsSeen
    supervising: ViewsSeen

    def on(self, number: int) -> str:
        """In words, on a track of so many views; empty where there is one."""
        counts = {"one": 1, "all": number}
        return f"{counts[self.given]} in, {counts[self.supervising]} supervise" if number > 1 else ""


@dataclass(frozen=True)
class ModelSpec:
    """One model that can be named on the command line."""

    build: Callable[[Options], Segmenter]
    """Makes a model from one value of its grid and the options on offer; see `benchmark.models.interface`."""
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
    labelled_trials: int = 0
    """How many values of its constants were compared by scores on labelled validation scenes before it was declared, if
    any were; rows are marked like tuned ones."""
    settings: Options = field(default_factory=dict)
    """Constants that its results depend on beside its version and options; rows are made anew when they change."""

    profiles: Mapping[str, Options] = field(default_factory=dict)
    """The same in other profiles than `cpu`, where they differ."""
    on_tracks: Mapping[str, Options] = field(default_factory=dict)
    """Changes of its settings by dotted name where it is fitted on a track of this name, as an option `changes`."""
    views: Views | None = None
    """Which views it uses, if it says so."""
    configured: Callable[[Path], "ModelSpec"] | None = None
    """The same with the priors and views of a folder's weights, which may be others than the model's own."""

    @property
    def default(self) -> Options:
        """The first value of the grid."""
        return self.grid[0] if self.grid else {}

    @property
    def trials_with_labels(self) -> int:
        """How many values its settings are the best of by scores on labelled validation scenes; 0 if by none."""
        return self.labelled_trials + (len(self.grid) if len(self.grid) > 1 else 0)

    @property
    def takes_slots(self) -> bool:
        """Whether it is told how many slots to use, or finds the number of objects itself."""
        return not (isinstance(self.build, Builder) and "slots" in self.build.refused)

    def settings_in(self, profile: Profile) -> Options:
        """The constants in a profile."""
        return self.profiles.get(profile, self.settings)


OFFERED: tuple[str, ...] = ("slots", "steps", "folder", "checkpoint", "profile", "changes", "watch")
"""Options that every model is offered, and gets if its constructor has an argument of that name; see
`benchmark.models.interface`."""


@dataclass(frozen=True)
class Builder:
    """Calls a class with the options as keyword arguments; with `OFFERED` ones only if its constructor has them."""

    model: Callable[..., Segmenter]

    @property
    def refused(self) -> set[str]:
        """Options on offer that it does not take."""
        return set(OFFERED) - set(inspect.signature(self.model).parameters)

    def __call__(self, options: Options) -> Segmenter:
        """The model."""
        refused = self.refused
        return self.model(**{name: value for name, value in options.items() if name not in refused})
