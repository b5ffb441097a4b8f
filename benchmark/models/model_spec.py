"""Facts that the benchmark needs about a model."""

import dataclasses
import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from benchmark.models.interface import Segmenter
from datagen.tracks import Profile
from obpose.config_text import ADDED_LATER

Options = Mapping[str, Any]
"""Keyword arguments of a model's constructor: numbers, strings, booleans."""

Kind = Literal["floor", "classical", "oracle", "learned", "predictions"]
KINDS: tuple[str, ...] = get_args(Kind)

PRIORS = ("slots", "background slot", "camera pose", "plane", "object size")
"""Possible inputs of a model beyond the images: number of slots, label of the background, camera poses, a planar
background, maximum size of objects."""

DEFAULT_BUDGET = 600.0
"""Default training budget, seconds of one core."""


ViewsSeen = Literal["one", "all"]
"""Number of views of a frame."""
VIEWS_SEEN: tuple[ViewsSeen, ...] = get_args(ViewsSeen)


@dataclass(frozen=True)
class Views:
    """Views of a frame that a model gets as input, and views that supervise its training."""

    given: ViewsSeen
    supervising: ViewsSeen

    def on(self, number: int) -> str:
        """Describe the views on a track with `number` views; empty if there is only one."""
        counts = {"one": 1, "all": number}
        return f"{counts[self.given]} in, {counts[self.supervising]} supervise" if number > 1 else ""


@dataclass(frozen=True)
class ModelSpec:
    """A model of the registry."""

    build: Callable[[Options], Segmenter]
    """Builds a model from one value of its grid and the offered options; see `benchmark.models.interface`."""
    version: int
    """Version; raise it when the model's results change."""
    description: str
    kind: Kind = "learned"
    grid: tuple[Options, ...] = ()
    """Values to tune over, the default first; empty if nothing is tuned."""
    random: bool = True
    """Whether results depend on the seed; if not, the model runs once."""
    uses_labels: bool = False
    """Whether its clips carry `truth`."""
    priors: tuple[str, ...] = ()
    """Inputs beyond the images, out of `PRIORS`."""
    budget: float = DEFAULT_BUDGET
    """Training budget in seconds of one core, unless the command sets another."""
    extra: tuple[str, ...] = ()
    """Names of the segmentations in `Prediction.extra`; each gets its own row."""
    uses_time: bool = False
    """Whether the segmentation of a frame depends on the other frames; tuning then uses whole clips."""
    labelled_trials: int = 0
    """Number of settings that were compared on labelled validation scenes during development; if not 0, rows are marked
    as tuned."""
    settings: Options = field(default_factory=dict)
    """Constants that results depend on besides version and options; rows are made again when they change."""

    profiles: Mapping[str, Options] = field(default_factory=dict)
    """Settings in profiles other than `cpu`, if they differ."""
    on_tracks: Mapping[str, Options] = field(default_factory=dict)
    """Changes of settings by dotted name, by the track that it is fitted on; passed as option `changes`."""
    at_test: Mapping[str, Options] = field(default_factory=dict)
    """Changes of settings by the track that is scored, whatever the model was fitted on; needs a
    `benchmark.models.interface.Changeable`. Weights that are given keep their settings."""
    views: Views | None = None
    """Views that it uses, if declared."""
    configured: Callable[[Path], "ModelSpec"] | None = None
    """Function that gives the specification for weights in a folder, whose priors and views may differ."""

    @property
    def default(self) -> Options:
        """The first value of the grid."""
        return self.grid[0] if self.grid else {}

    @property
    def trials_with_labels(self) -> int:
        """Number of settings that were compared by scores on labelled validation scenes; 0 without a comparison."""
        return self.labelled_trials + (len(self.grid) if len(self.grid) > 1 else 0)

    @property
    def takes_slots(self) -> bool:
        """Whether it takes the number of slots as an option; other models find the number of objects themselves."""
        return not isinstance(self.build, Builder) or self.build.takes("slots")

    def settings_in(self, profile: Profile) -> Options:
        """The constants in a profile."""
        return self.profiles.get(profile, self.settings)


OFFERED: tuple[str, ...] = ("slots", "steps", "folder", "checkpoint", "profile", "changes", "watch")
"""Options offered to all models; a model gets those that are arguments of its constructor. See
`benchmark.models.interface`."""


@dataclass(frozen=True)
class Builder:
    """Builds a model from options, without those `OFFERED` ones that its constructor lacks."""

    model: Callable[..., Segmenter]

    def takes(self, option: str) -> bool:
        """Tell whether the constructor gets an option; those that are not `OFFERED` are always passed."""
        return option not in OFFERED or option in inspect.signature(self.model).parameters

    def __call__(self, options: Options) -> Segmenter:
        """Build the model."""
        return self.model(**{name: value for name, value in options.items() if self.takes(name)})


def settings_of(config: Any) -> dict[str, Any]:
    """Give all values of a configuration on which results depend, nested as in the configuration."""
    settings = dataclasses.asdict(config, dict_factory=_without_later)
    if math.isinf(config.train.minutes):
        settings["train"]["minutes"] = None  # steps count, and JSON has no inf
    return settings


def _without_later(values: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    return {name: value for name, value in values if (name, value) not in ADDED_LATER.items()}
