"""All learned systems by name: their configuration, their builder, and their entries in tables.

    system = find_system("obsurf-no-overlap")
    config = system.config("cpu", {"train.seed": 3})
    model = build_model(config)

Importing PyTorch takes seconds, so only building a model does it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any

from obpose.baselines.obsurf.config import OBSURF_PROFILES, OBSURF_SEARCHED, OBSURF_VARIANTS, ObsurfConfig
from obpose.baselines.obsurf.config_bounds import check_obsurf_bounds
from obpose.config import Config, override
from obpose.config_bounds import check_bounds
from obpose.config_text import dotted_values
from obpose.contact.config import (
    RISE,
    ContactConfig,
    ContactObPoseConfig,
    OgcConfig,
    SupervisedConfig,
    check_contact_bounds,
    check_contact_obpose_bounds,
)
from obpose.errors import unknown_name
from obpose.variants import PROFILES, SEARCHED, VARIANTS, make_config, searched_in

if TYPE_CHECKING:
    from obpose.trainable import Trainable

Changes = Mapping[str, Any]
"""Values of a configuration by dotted name."""


@dataclass(frozen=True)
class Architecture:
    """Systems that differ only in the values of one kind of configuration."""

    name: str
    """Name in checkpoints."""
    config: type
    """Class of the configuration, a dataclass whose defaults are the profile `cpu`."""
    profiles: Mapping[str, Changes]
    builder: str
    """Function or class that builds a model with fresh weights: its place, as importing it imports PyTorch."""
    check: Callable[[Any], None]
    """Function that raises an error if a configuration cannot be built and trained."""


@dataclass(frozen=True)
class System:
    """Learned system of the tables."""

    architecture: Architecture
    changes: Changes
    """Configuration changes, beside those of the profile."""
    description: str
    priors: tuple[str, ...]
    """Knowledge beyond the images, of `benchmark.models.model_spec.PRIORS`."""
    version: int = 1
    """Version, raised when results change."""
    uses_labels: bool = False
    """Whether the system is trained with labels."""
    extra: tuple[str, ...] = ("att",)
    """Name of `Segmentation.attention` in tables, which show it beside the labels: `att`, masks without the decoder or
    the clip; `density`, labels by the composed density."""
    searched: Changes = field(default_factory=dict)
    """Further changes in the profile `cpu`, chosen for it by a search."""
    on_tracks: Mapping[str, Changes] = field(default_factory=dict)
    """Further changes for training on a track, by its name."""
    at_test: Mapping[str, Changes] = field(default_factory=dict)
    """Further changes for segmenting scenes of a track, by its name, whatever the weights were trained on. They do not
    change the weights."""

    def config(self, profile: str = "cpu", changes: Changes | None = None) -> Any:
        """Make the configuration; `changes` are applied last.

        Raises:
            KeyError: an unknown profile or name.
        """
        searched = searched_in(profile, self.searched)
        all_changes = {**self.architecture.profiles[profile], **self.changes, **searched, **(changes or {})}
        return override(self.architecture.config(), all_changes)

    def changes_on(self, track: str) -> Changes:
        """Changes for training on a track and segmenting its scenes; empty for other names."""
        return {**self.on_tracks.get(track, {}), **self.at_test.get(track, {})}

    def known(self, changes: Changes) -> dict[str, Any]:
        """Select the changes whose names the configuration has: systems use different statistics of the scene."""
        names = {name for name, _ in dotted_values(self.architecture.config())}
        return {name: value for name, value in changes.items() if name in names}


OBPOSE = Architecture("obpose", Config, PROFILES, "obpose.model.build.build_obpose", check_bounds)
OBSURF = Architecture(
    "obsurf", ObsurfConfig, OBSURF_PROFILES, "obpose.baselines.obsurf.model.Obsurf", check_obsurf_bounds
)
_CONTACT_PROFILES: dict[str, Changes] = {"cpu": {}, "gpu": {"train.batch": 256, "train.precision": "bf16-mixed"}}
SUPERVISED = Architecture(
    "supervised",
    SupervisedConfig,
    _CONTACT_PROFILES,
    "obpose.baselines.supervised.Supervised",
    check_contact_bounds,
)
CONTACT = Architecture(
    "contact", ContactConfig, _CONTACT_PROFILES, "obpose.contact.model.ContactModel", check_contact_bounds
)
OGC = Architecture("ogc", OgcConfig, _CONTACT_PROFILES, "obpose.baselines.ogc.Ogc", check_contact_bounds)
OBPOSE_CONTACT = Architecture(
    "obpose-contact",
    ContactObPoseConfig,
    PROFILES,
    "obpose.contact.scene_model.build_contact_obpose",
    check_contact_obpose_bounds,
)
ARCHITECTURES = {
    architecture.name: architecture for architecture in (OBPOSE, OBSURF, SUPERVISED, CONTACT, OGC, OBPOSE_CONTACT)
}

DESCRIPTIONS = {
    "obpose": "objects encoded at their location and rotation",
    "obpose-loc": "obpose with objects encoded at their location only",
    "obpose-none": "obpose with objects encoded in the workspace's frame",
    "obpose-l2": "obpose with the paper's other attention loss",
    "obpose-as-published": "obpose without most of our additions",
    "ic-sbp": "IC-SBP without background, poses or boxes",
    "slot-attention": "slot attention without poses or boxes",
    "slot-attention-as-published": "slot-attention with two defects of the published code",
    "obsurf": "ObSuRF with depth supervision and its overlap loss",
    "obsurf-no-overlap": "obsurf without the overlap loss",
    "obsurf-no-overlap-depth": "obsurf-no-overlap with depth as an input, too",
    "supervised": "network and losses of contact-masks, trained with labels",
    "ogc": "network of contact-masks, trained by rigid motion between frames (OGC)",
    "contact-masks": "masks alone, learned from pasted contacts, decided over the clip",
    "obpose-contact": "obpose with the masks of contact-masks",
}


_LARGER_BOXES: Changes = {"model.pose.box_size": 0.35}
"""Changes for objects of up to 30 cm; objects of other tracks are at most 18 cm long, and boxes 20 cm."""
_BIAS = {
    **dict.fromkeys(("cluttered", "touching"), 0.0),
    "mixed": 1.0,
    **dict.fromkeys(("moving", "same-colour", "textured", "two-colour"), 1.5),
    **dict.fromkeys(("clevr3d", "multishape", "static"), 2.5),
}
"""Bias on tracks: the less often objects touch, the larger; in stills, no motion joins parts again."""
_COMPLETED: Changes = {"model.pose.max_translation": 0.05}
"""Changes for few kinds of shapes, whose hidden sides can be learned from other views."""


def _obpose_system(variant: str) -> System:
    larger = variant in ("obpose", "obpose-loc", "obpose-l2")
    on_tracks = {"desk": _LARGER_BOXES, "multishape": _LARGER_BOXES} if larger else {}
    facts = (VARIANTS[variant], DESCRIPTIONS[variant], _priors(make_config(variant)))
    return System(OBPOSE, *facts, version=2, searched=SEARCHED.get(variant, {}), on_tracks=on_tracks)


def priors_of(config: Any) -> tuple[str, ...]:
    """Knowledge of a model with this configuration beyond the images, of `benchmark.models.model_spec.PRIORS`.

    Raises:
        TypeError: as `architecture_of`.
    """
    return _priors(config) if architecture_of(config) is OBPOSE else SYSTEMS[system_of(config)].priors


def _priors(config: Config) -> tuple[str, ...]:
    """Knowledge of a variant of ObPose."""
    model = config.model
    has_boxes = model.pose.conditioning in ("location", "full")
    priors = {
        "slots": True,
        "background slot": model.has_background,
        "camera pose": True,
        # In boxes, shapes are estimated that end at the floor.
        "plane": model.table is not None or has_boxes,
        "object size": has_boxes,
    }
    return tuple(name for name, used in priors.items() if used)


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
        ("background slot", "camera pose", "plane"),
        version=7,
        uses_labels=True,
        at_test={track: {"model.bias": bias} for track, bias in _BIAS.items()},
    ),
    "ogc": System(OGC, {}, DESCRIPTIONS["ogc"], ("slots", "background slot", "camera pose", "plane"), version=3),
    "contact-masks": System(
        CONTACT,
        {},
        DESCRIPTIONS["contact-masks"],
        ("background slot", "camera pose", "plane"),
        version=4,
        on_tracks={"noisy": {"model.bias": 1.0, "model.clean_depth": True}},
        at_test={track: {"model.bias": bias} for track, bias in _BIAS.items()},
    ),
    "obpose-contact": System(
        OBPOSE_CONTACT,
        {
            "model.attention.kind": "given",
            "model.pose.max_translation": 0.0,
            "loss.air_growth": 10.0,
            "train.rise": RISE,
            "train.minutes": 24.0,
        },
        DESCRIPTIONS["obpose-contact"],
        ("background slot", "camera pose", "plane", "object size"),
        version=6,
        extra=("density",),
        on_tracks={
            "clevr3d": _COMPLETED,
            "desk": _LARGER_BOXES,
            "multishape": _LARGER_BOXES,
            "noisy": {"contact.bias": 1.0, "contact.clean_depth": True},
        },
        at_test={track: {"contact.bias": bias} for track, bias in _BIAS.items()},
    ),
}
"""Systems by the names of the benchmark's models and of `obpose-train --variant`."""


def find_system(name: str) -> System:
    """Find a system by name.

    Raises:
        UsageError: there is none; the message suggests a similar name.
    """
    if name not in SYSTEMS:
        raise unknown_name("variant", name, SYSTEMS)
    return SYSTEMS[name]


def architecture_of(config: object) -> Architecture:
    """Find the architecture that a configuration belongs to.

    Raises:
        TypeError: there is none.
    """
    for architecture in ARCHITECTURES.values():
        if type(config) is architecture.config:
            return architecture
    raise TypeError(f"No architecture is configured by {type(config).__name__}; see obpose/systems.py.")


def system_of(config: object) -> str:
    """Name the system, in any profile, that shares the most values with a configuration.

    A run changes some values of its system, such as slots and the statistics of its scenes.

    Raises:
        TypeError: as `architecture_of`.
    """
    architecture = architecture_of(config)
    own = dict(dotted_values(config))
    distances = {
        name: min(
            sum(own[other] != value for other, value in dotted_values(system.config(profile)))
            for profile in architecture.profiles
        )
        for name, system in SYSTEMS.items()
        if system.architecture is architecture
    }
    return min(distances, key=distances.__getitem__)


def slots_for(segments: int) -> dict[str, int]:
    """Configuration change for a dataset with this many segments per scene, the background included.

    Datasets and the benchmark count the background, `model.slots` does not. The property `segments` of configurations
    is the inverse.
    """
    return {"model.slots": segments - 1}


def build_model(config: Any) -> "Trainable":
    """Build the model of a configuration, with fresh weights."""
    module, _, name = architecture_of(config).builder.rpartition(".")
    return getattr(import_module(module), name)(config)
