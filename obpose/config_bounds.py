"""Which values of a configuration make sense: bounds that their types cannot say, looked at before anything is made."""

import math
from collections.abc import Callable, Iterable
from functools import reduce
from typing import Any

from obpose.config import Config
from obpose.config_text import dotted_values
from obpose.errors import UsageError

Rule = tuple[str, Callable[[Any], bool], str]
"""Dotted names, apart by spaces, what must hold of their values, and that in words. `None` is always let through."""


def counts(names: str) -> Rule:
    """One at least."""
    return names, lambda value: value >= 1, "1 or more"


def positive(names: str) -> Rule:
    """Above 0."""
    return names, lambda value: 0 < value < math.inf, "more than 0, and finite"


def not_negative(names: str) -> Rule:
    """0 or above."""
    return names, lambda value: 0 <= value < math.inf, "0 or more, and finite"


def between_0_and_1(names: str) -> Rule:
    """Neither of the two."""
    return names, lambda value: 0 < value < 1, "between 0 and 1"


def at_most(names: str, limit: int) -> Rule:
    """Not so much that only a slip of the finger explains it, or numbers stop making sense."""
    return names, lambda value: value <= limit, f"at most {limit}"


TRAINING: tuple[Rule, ...] = (
    counts("train.batch train.frames train.steps"),
    at_most("train.batch train.frames train.rays", 1_000_000),
    # Label images have 8 bits: the background, and so many objects.
    at_most("model.slots", 254),
    positive("train.learning_rate train.minutes train.half_life"),
    not_negative("train.rays train.clip train.skip train.warmup"),
    ("train.seed", lambda value: 0 <= value < 2**63, "0 or more, and less than 2^63"),
    ("train.object_rays", lambda value: 0 <= value < 1, "0 or more, and less than 1"),
)
"""Of every architecture."""

_COUNTS = """model.slots model.voxels model.backbone.input_stride model.backbone.embedding model.backbone.feature
model.latent.where model.latent.what model.latent.background model.latent.hidden model.latent.encoder
model.latent.samples model.object_field.width model.object_field.depth model.background_field.width
model.background_field.depth
model.slot_attention.iterations model.slot_attention.width"""
_POSITIVE = """model.backbone.radius model.pose.box_size model.spacing model.workspace_size model.background_size
loss.sigma_max loss.colour_std loss.air_growth
model.attention.mask_power model.latent.radius model.latent.posterior_std loss.air_saturation"""
_NOT_NEGATIVE = """model.attention.semi_convolution model.attention.semi_colour model.attention.looks
model.attention.idle_points model.attention.evaluation_rounds
model.pose.max_translation model.pose.min_points model.pose.min_pixels
model.pose.grid_level model.pose.refinements model.pose.tolerance model.object_field.position_frequencies
model.object_field.direction_frequencies model.background_field.position_frequencies
model.background_field.direction_frequencies loss.colour loss.surface loss.air loss.mask loss.scope loss.translation
loss.kl loss.kl_where loss.jitter
model.slot_attention.position_frequencies model.latent.frequencies"""

_FREQUENCIES = """model.object_field.position_frequencies model.object_field.direction_frequencies
model.background_field.position_frequencies model.background_field.direction_frequencies
model.slot_attention.position_frequencies model.latent.frequencies"""
_SIZES = """model.voxels model.backbone.embedding model.backbone.feature model.latent.where model.latent.what
model.latent.background model.latent.hidden model.latent.encoder model.object_field.width model.object_field.depth
model.background_field.width model.background_field.depth model.slot_attention.width"""


def check_bounds(config: Config) -> None:
    """Let a configuration pass only if a model can be made of it and trained.

    Raises:
        UsageError: names the first value that is out of bounds, and what is expected.
    """
    check_values(
        config,
        (
            counts(_COUNTS),
            positive(_POSITIVE),
            not_negative(_NOT_NEGATIVE),
            between_0_and_1("loss.near_share model.attention.idle_scope"),
            # Each level has eight times the rotations of the one before: at 4 these are 294,912.
            at_most("model.pose.grid_level", 4),
            # 2^k turns in single precision.
            at_most(_FREQUENCIES, 24),
            at_most(_SIZES, 65_536),
            # The position is added to three of them, the colour to three more.
            ("model.backbone.colour", lambda value: value >= 6, "6 or more"),
            *TRAINING,
        ),
    )
    _check_levels(config)
    _check_parts(config)


def check_values(config: Any, rules: Iterable[Rule]) -> None:
    """Let a configuration of any architecture pass only if its values keep to the rules, and all are numbers.

    Raises:
        UsageError: names the first value that does not.
    """
    for name, value in dotted_values(config):
        expect(not (isinstance(value, float) and math.isnan(value)), name, value, "a number")
        within = value if isinstance(value, tuple) else ()
        finite = all(math.isfinite(each) for each in within if isinstance(each, float))
        expect(finite, name, value, "finite numbers")
    for names, holds, expected in rules:
        for name in names.split():
            value = reduce(getattr, name.split("."), config)
            expect(value is None or holds(value), name, value, expected)


def expect(holds: bool, name: str, value: Any, expected: str) -> None:
    """Let a value pass.

    Raises:
        UsageError: it does not hold, and what was expected.
    """
    if not holds:
        raise UsageError(f"{name} is {value}; expected {expected}.")


def _check_levels(config: Config) -> None:
    """The lists of the backbone, an entry a level, fit each other."""
    backbone = config.model.backbone
    levels = len(backbone.widths)
    expect(levels > 0 and min(backbone.widths) >= 4, "model.backbone.widths", backbone.widths, "numbers of 4 or more")
    fits = len(backbone.blocks) == levels and min(backbone.blocks) >= 0
    expect(fits, "model.backbone.blocks", backbone.blocks, f"{levels} numbers, one for each of model.backbone.widths")
    expect(
        0 <= backbone.output_level < levels, "model.backbone.output_level", backbone.output_level, f"0 to {levels - 1}"
    )


def _check_parts(config: Config) -> None:
    """Parts that need each other are there."""
    model, train = config.model, config.train
    conditioning = model.pose.conditioning
    if model.background == "none":
        fills = "world, as without a background objects have to fill all space"
        expect(conditioning == "world", "model.pose.conditioning", conditioning, fills)
        expect(model.table is None, "model.table", model.table, "none, as without a background the table is a slot's")
        expect(train.warmup == 0, "train.warmup", train.warmup, "0, as there is no background to warm up")
    if model.attention.kind == "slots":
        unposed = conditioning in ("none", "world")
        expect(unposed, "model.pose.conditioning", conditioning, "none or world, as slot attention has no boxes")
        rounds, nothing = model.attention.evaluation_rounds, "0, as slot attention reads nothing from masks"
        expect(rounds == 0, "model.attention.evaluation_rounds", rounds, nothing)
