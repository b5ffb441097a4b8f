"""The systems that learn, by name: what each is configured by, how its model is made, and what tables say about it.

    system = find_system("obsurf-no-overlap")
    config = system.config("cpu", {"train.seed": 3})
    model = build_model(config)

PyTorch takes seconds to import, so that only building a model does it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from obpose.baselines.obsurf.config import OBSURF_PROFILES, OBSURF_SEARCHED, OBSURF_VARIANTS, ObsurfConfig
from obpose.baselines.obsurf.config_bounds import check_obsurf_bounds
from obpose.config import Config, SupervisedConfig, override
from obpose.config_bounds import check_bounds
from obpose.config_text import dotted_values
from obpose.errors import unknown_name
from obpose.variants import PROFILES, SEARCHED, VARIANTS, make_config, searched_in

if TYPE_CHECKING:
    from obpose.trainable import Trainable

Changes = Mapping[str, Any]
"""Values of a configuration by dotted name."""


@dataclass(frozen=True)
class Architecture:
    """Systems that differ in nothing but the values of one kind of configuration."""

    name: str
    """Stands in checkpoints."""
    config: type
    """The kind of configuration, a dataclass whose defaults are the profile `cpu`."""
    profiles: Mapping[str, Changes]
    build: Callable[[Any], "Trainable"]
    """Makes a model with fresh weights."""
    check: Callable[[Any], None]
    """Lets a configuration pass only if a model can be made of it and trained."""


@dataclass(frozen=True)
class System:
    """One entry of the tables."""

    architecture: Architecture
    changes: Changes
    """What it changes in the configuration, beside the profile."""
    description: str
    priors: tuple[str, ...]
    """What it is told beyond the images, out of `benchmark.models.model_spec.PRIORS`."""
    version: int = 1
    """Rises when its results change."""
    uses_labels: bool = False
    """Whether it learns from labels."""
    extra: tuple[str, ...] = ("att",)
    """What tables show of it beside its labels: `att`, the attention masks."""
    searched: Changes = field(default_factory=dict)
    """What it changes besides in the profile `cpu`, for which it was chosen by a search."""
    on_tracks: Mapping[str, Changes] = field(default_factory=dict)
    """What it changes besides where it is trained on a track of this name."""

    def config(self, profile: str = "cpu", changes: Changes | None = None) -> Any:
        """Its configuration; the changes come last.

        Raises:
            KeyError: an unknown profile or name.
        """
        searched = searched_in(profile, self.searched)
        all_changes = {**self.architecture.profiles[profile], **self.changes, **searched, **(changes or {})}
        return override(self.architecture.config(), all_changes)

    def known(self, changes: Changes) -> dict[str, Any]:
        """Those changes that its configuration has a value for: measures of the scene are not all for everybody."""
        names = {name for name, _ in dotted_values(self.architecture.config())}
        return {name: value for name, value in changes.items() if name in names}


def _build_obpose(config: Config) -> "Trainable":
    from obpose.model.obpose import ObPose

    return ObPose(config)


def _build_obsurf(config: ObsurfConfig) -> "Trainable":
    from obpose.baselines.obsurf.model import Obsurf

    return Obsurf(config)


def _build_supervised(config: SupervisedConfig) -> "Trainable":
    from obpose.baselines.supervised import Supervised

    return Supervised(config)


OBPOSE = Architecture("obpose", Config, PROFILES, _build_obpose, check_bounds)
OBSURF = Architecture("obsurf", ObsurfConfig, OBSURF_PROFILES, _build_obsurf, check_obsurf_bounds)
SUPERVISED = Architecture("supervised", SupervisedConfig, PROFILES, _build_supervised, check_bounds)
ARCHITECTURES = {architecture.name: architecture for architecture in (OBPOSE, OBSURF, SUPERVISED)}

DESCRIPTIONS = {
    "obpose": "objects at their location and rotation",
    "obpose-loc": "the same at their location only",
    "obpose-none": "the same in the workspace's frame",
    "obpose-l2": "obpose with the paper's other attention loss",
    "obpose-sharp": "obpose with sharper surfaces, for pictures",
    "obpose-as-published": "obpose without most of our additions",
    "ic-sbp": "IC-SBP without background, poses or boxes",
    "slot-attention": "slot attention without poses or boxes",
    "slot-attention-as-published": "the same with two defects of the published code",
    "obsurf": "ObSuRF with depth supervision and its overlap loss",
    "obsurf-no-overlap": "the same without the overlap loss",
    "obsurf-no-overlap-depth": "the same with depth as an input, too",
    "supervised": "backbone and IC-SBP of obpose, trained with labels",
}


_LARGER_BOXES: dict[str, Changes] = {"multishape": {"model.pose.box_size": 0.35}}
"""Objects are up to 28 cm long there, and at most 18 cm on the other tracks; elsewhere boxes have edges of 20 cm."""


def _obpose_system(variant: str) -> System:
    on_tracks = _LARGER_BOXES if variant in ("obpose", "obpose-loc", "obpose-l2", "obpose-sharp") else {}
    facts = (VARIANTS[variant], DESCRIPTIONS[variant], _priors(make_config(variant)))
    return System(OBPOSE, *facts, version=2, searched=SEARCHED.get(variant, {}), on_tracks=on_tracks)


def priors_of(config: Any) -> tuple[str, ...]:
    """What a model of this configuration is told beyond the images, out of `benchmark.models.model_spec.PRIORS`.

    Raises:
        TypeError: as `architecture_of`.
    """
    return _priors(config) if architecture_of(config) is OBPOSE else SYSTEMS[system_of(config)].priors


def _priors(config: Config) -> tuple[str, ...]:
    """What a variant of ObPose is told."""
    model = config.model
    has_boxes = model.pose.conditioning in ("location", "full")
    priors = {
        "slots": True,
        "background slot": model.background == "component",
        "camera pose": True,
        # In their boxes shapes are estimated, which end at the floor.
        "plane": model.table is not None or (has_boxes and model.floor is not None),
        "object size": has_boxes,
    }
    return tuple(name for name, told in priors.items() if told)


SYSTEMS: dict[str, System] = {
    **{variant: _obpose_system(variant) for variant in VARIANTS},
    **{
        variant: System(
            OBSURF,
            changes,
            DESCRIPTIONS[variant],
            ("slots", "camera pose"),
            version=3,
            searched=OBSURF_SEARCHED.get(variant, {}),
        )
        for variant, changes in OBSURF_VARIANTS.items()
    },
    "supervised": System(
        SUPERVISED,
        {},
        DESCRIPTIONS["supervised"],
        ("slots", "background slot", "camera pose"),
        uses_labels=True,
        extra=(),
    ),
}
"""By the names of the benchmark's models and of `obpose-train --variant`."""


def find_system(name: str) -> System:
    """The system of that name.

    Raises:
        UsageError: there is none, and says which name is near.
    """
    if name not in SYSTEMS:
        raise unknown_name("variant", name, SYSTEMS)
    return SYSTEMS[name]


def architecture_of(config: object) -> Architecture:
    """The architecture that a configuration is of.

    Raises:
        TypeError: of none of these.
    """
    for architecture in ARCHITECTURES.values():
        if type(config) is architecture.config:
            return architecture
    raise TypeError(f"No architecture is configured by {type(config).__name__}; see obpose/systems.py.")


def system_of(config: object) -> str:
    """The name of the system that a configuration is of: the one whose values it shares most, in any profile.

    A run changes some values of its system, such as slots and the measures of its scenes.

    Raises:
        TypeError: as `architecture_of`.
    """
    architecture = architecture_of(config)
    own = dict(dotted_values(config))
    distances = {
        name: min(_differing(own, system.config(profile)) for profile in architecture.profiles)
        for name, system in SYSTEMS.items()
        if system.architecture is architecture
    }
    return min(distances, key=distances.__getitem__)


def _differing(own: Mapping[str, Any], config: Any) -> int:
    return sum(own[name] != value for name, value in dotted_values(config))


def build_model(config: Any) -> "Trainable":
    """The model of a configuration, with fresh weights."""
    return architecture_of(config).build(config)
