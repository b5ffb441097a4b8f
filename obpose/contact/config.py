"""Configuration of the contact model, with bounds. All defaults are ours."""

import math
from dataclasses import dataclass, field

from obpose.config import Config, TrainConfig
from obpose.config_bounds import (
    SLOTS,
    TRAINING,
    Rule,
    at_most,
    check_bounds,
    check_values,
    expect,
    not_negative,
    positive,
)

LEAST_FLOOR = 0.0003
"""Height in metres above the table from which points belong to objects, for exact depth."""
FLOOR_NOISE = 4.0
"""Height above the table from which points belong to objects, for noisy depth, in standard deviations of the noise."""
SMOOTHED = 3.0
"""Factor by which cleaning reduces the noise of planes (`obpose.data.clean_depth.smooth_depth`)."""
TABLE_TOLERANCE = 0.0015
"""Largest difference in metres of the two heights of the table in a configuration of `obpose-contact`."""
LARGEST_SCALE = 64
"""Largest `image_scale`: images of 4096 pixels."""
RISE = 0.1
"""Share of the budget over which the learning rate rises. Without it, the network finds fewer borders to the end."""


@dataclass(frozen=True)
class ContactModelConfig:
    """The architecture, and how its outputs become objects."""

    table: float = 0.0
    """Height of the table above the world's z = 0, metres."""
    noise: float = 0.0
    """Standard deviation of the table's points about a plane, metres; measured before training
    (`obpose.data.scene_stats.measure_scene`)."""
    clean_depth: bool = False
    """Whether noisy depth is smoothed, and narrow holes are filled, in training and afterwards
    (`obpose.data.clean_depth`). Specks far from their object then become background (`obpose.contact.clip`)."""
    gap: float = 0.06
    """Largest distance in metres between neighbouring points of a pseudo-object."""
    self_training: bool = False
    """Whether the network divides pseudo-objects that hold several objects, after half of the training
    (`obpose.contact.self_training`)."""
    bias: float = 0.5
    """Value added to the logits of affinities before pixels are grouped: larger values divide less."""
    division_gap: float | None = None
    """Connected components of the foreground are divided whatever the network says, except for specks that join a
    neighbour. Neighbouring pixels are connected if they are at most this far apart, metres; None: not divided. It makes
    frames of unfamiliar cameras safer, and divides what an object in front hides in the middle."""
    workspace_center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Middle of the observed points, world frame, metres; measured before training."""
    spacing: float = 0.01
    """Median distance in metres between the surface points of neighbouring pixels; measured before training."""
    image_scale: int = 1
    """Width of the training images in units of 64 pixels, rounded; measured before training. Partners of pixels are
    that many times as far away, in images of any width."""

    @property
    def floor(self) -> float:
        """Height in metres above the table from which points belong to objects."""
        noise = self.noise / SMOOTHED if self.clean_depth else self.noise
        return max(LEAST_FLOOR, FLOOR_NOISE * noise)

    @property
    def exact(self) -> bool:
        """Whether depth is so exact that the floor is lower than what the network can tell from the table."""
        return self.floor == LEAST_FLOOR


@dataclass(frozen=True)
class ContactConfig:
    """All settings of a run of the contact model, except for its data."""

    model: ContactModelConfig = field(default_factory=ContactModelConfig)
    train: TrainConfig = field(
        default_factory=lambda: TrainConfig(
            batch=16, frames=1, learning_rate=3e-3, rise=RISE, clip=5.0, warmup=0, minutes=12.0, views="separate"
        )
    )


@dataclass(frozen=True)
class ContactObPoseConfig(Config):
    """All settings of a run of ObPose with the masks of the contact model, except for its data."""

    contact: ContactModelConfig = field(default_factory=ContactModelConfig)


@dataclass(frozen=True)
class SupervisedConfig(ContactConfig):
    """Configuration of `obpose.baselines.supervised`, with the same defaults."""


@dataclass(frozen=True)
class OgcModelConfig(ContactModelConfig):
    """Configuration of the architecture of `obpose.baselines.ogc`."""

    slots: int = 4
    """Number of masks, the background's not included."""


@dataclass(frozen=True)
class OgcConfig(ContactConfig):
    """Configuration of `obpose.baselines.ogc`, which learns from pairs of neighbouring frames."""

    model: OgcModelConfig = field(default_factory=OgcModelConfig)
    train: TrainConfig = field(
        default_factory=lambda: TrainConfig(batch=4, frames=2, clip=5.0, warmup=0, minutes=12.0, views="separate")
    )


def model_rules(part: str) -> tuple[Rule, ...]:
    """Give the rules for a `ContactModelConfig` that is the value `part` of a configuration."""
    division = f"{part}.division_gap"
    return (
        positive(f"{part}.gap {part}.spacing {part}.image_scale"),
        at_most(f"{part}.image_scale", LARGEST_SCALE),
        (division, lambda value: value is None or 0 < value < math.inf, "none, or more than 0 and finite"),
        not_negative(f"{part}.noise"),
    )


def check_contact_bounds(config: ContactConfig) -> None:
    """Check that a configuration can be built and trained.

    Raises:
        UsageError: a value is out of bounds; the message names the first one and what is expected.
    """
    check_values(config, (*TRAINING, *model_rules("model"), *(SLOTS if isinstance(config, OgcConfig) else ())))
    frames, views = config.train.frames, config.train.views
    needed = 2 if isinstance(config, OgcConfig) else 1
    expect(frames == needed, "train.frames", frames, f"{needed}, as the network sees single images, or pairs of them")
    expect(views == "separate", "train.views", views, "separate, as the network sees single images")
    if isinstance(config, OgcConfig | SupervisedConfig):
        chosen = config.model.self_training
        expect(not chosen, "model.self_training", chosen, "false, as this model learns from no pseudo-objects")


def check_contact_obpose_bounds(config: ContactObPoseConfig) -> None:
    """Check that a configuration can be built and trained.

    Raises:
        UsageError: a value is out of bounds; the message names the first one and what is expected.
    """
    check_bounds(config)
    check_values(config, model_rules("contact"))
    model, views = config.model, config.train.views
    kind, background = model.attention.kind, model.background
    expect(kind == "given", "model.attention.kind", kind, "given, as the masks are those of the contact model")
    expect(background == "component", "model.background", background, "component, as masks have a background")
    expect(views == "random", "train.views", views, "random, as pseudo-objects of several views have no common labels")
    table, top = config.contact.table, model.table_top
    agree = model.table is None or abs(table - top) < TABLE_TOLERANCE
    expect(
        agree, "contact.table", table, f"the table's height, {top:g} by model.table, to {1000 * TABLE_TOLERANCE:g} mm"
    )
