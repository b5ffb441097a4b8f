"""Bounds of configuration values, checked before a model is built: types alone allow sizes of terabytes."""

import math
from collections.abc import Callable, Iterable
from functools import reduce
from typing import Any

from obpose.config import Config
from obpose.config_text import dotted_values
from obpose.errors import UsageError

Rule = tuple[str, Callable[[Any], bool], str]
"""A bound: dotted names separated by spaces, the test of their values, and its wording. `None` always passes."""


def counts(names: str) -> Rule:
    """Rule: 1 or more."""
    return names, lambda value: value >= 1, "1 or more"


def positive(names: str) -> Rule:
    """Rule: more than 0, and finite."""
    return names, lambda value: 0 < value < math.inf, "more than 0, and finite"


def not_negative(names: str) -> Rule:
    """Rule: 0 or more, and finite."""
    return names, lambda value: 0 <= value < math.inf, "0 or more, and finite"


def between_0_and_1(names: str) -> Rule:
    """Rule: between 0 and 1, both excluded."""
    return names, lambda value: 0 < value < 1, "between 0 and 1"


def at_most(names: str, limit: int) -> Rule:
    """Rule: at most `limit`, set by memory or by a reasonable duration."""
    return names, lambda value: value <= limit, f"at most {limit}"


MOST_STEPS, MOST_MINUTES = 10**9, 5_256_000
"""Largest budgets of a training, in steps and in minutes (ten years)."""
MOST_IMAGES = 4096
"""Largest number of images in a step; activations of more do not fit into memory."""

TRAINING: tuple[Rule, ...] = (
    counts("train.batch train.frames train.steps"),
    at_most("train.batch train.frames", MOST_IMAGES),
    at_most("train.rays", 1_000_000),
    at_most("train.steps", MOST_STEPS),
    at_most("train.minutes", MOST_MINUTES),
    # Label images have 8 bits: the background, and at most 254 objects.
    at_most("model.slots", 254),
    positive("train.learning_rate train.minutes train.half_life"),
    not_negative("train.rays train.clip train.skip train.warmup"),
    ("train.seed", lambda value: 0 <= value < 2**63, "0 or more, and less than 2^63"),
    ("train.object_rays", lambda value: 0 <= value < 1, "0 or more, and less than 1"),
)
"""Rules for the training of every architecture."""

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
_WIDTHS = """model.backbone.embedding model.backbone.colour model.backbone.feature model.latent.where
model.latent.what model.latent.background model.latent.hidden model.latent.encoder model.slot_attention.width"""
_FIELD_WIDTHS = "model.object_field.width model.background_field.width"
_FIELD_DEPTHS = "model.object_field.depth model.background_field.depth"
_ROUNDS = """model.attention.looks model.attention.evaluation_rounds model.pose.refinements
model.slot_attention.iterations"""
MOST_WIDTH, MOST_FIELD_WIDTH, MOST_DEPTH, MOST_LEVELS = 512, 1024, 16, 6
"""Largest sizes. A model with all of them has 0.8 GB of weights; the paper's models have a few megabytes."""
MOST_ROUNDS = 100


def check_bounds(config: Config) -> None:
    """Check that a configuration can be built and trained.

    Raises:
        UsageError: a value is out of bounds; the message names the first one and what is expected.
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
            at_most(_WIDTHS, MOST_WIDTH),
            at_most(_FIELD_WIDTHS, MOST_FIELD_WIDTH),
            at_most(_FIELD_DEPTHS, MOST_DEPTH),
            at_most(_ROUNDS, MOST_ROUNDS),
            # Their cube is the number of points at which a field is evaluated at once.
            at_most("model.voxels", 128),
            at_most("model.latent.samples", 1_000_000),
            at_most("model.backbone.input_stride", 1024),
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
        numbers = value if isinstance(value, tuple) else (value,)
        sensible = all(abs(each) <= MOST_NUMBER for each in numbers if isinstance(each, float))
        expect(sensible, name, value, f"finite numbers between {-MOST_NUMBER:g} and {MOST_NUMBER:g}")
    for names, holds, expected in rules:
        for name in names.split():
            value = reduce(getattr, name.split("."), config)
            expect(value is None or holds(value), name, value, expected)
    batch, frames = config.train.batch, config.train.frames
    images = f"a number that gives at most {MOST_IMAGES} images a step with train.frames, which is {frames}"
    expect(batch * frames <= MOST_IMAGES, "train.batch", batch, images)


MOST_NUMBER = 1e9
"""Largest magnitude of a number that is not whole, in whatever unit; products of a few stay finite."""


def expect(holds: bool, name: str, value: Any, expected: str) -> None:
    """Let a value pass.

    Raises:
        UsageError: it does not hold, and what was expected.
    """
    if not holds:
        raise UsageError(f"{name} is {value!s:.80}; expected {expected}.")


def _check_levels(config: Config) -> None:
    """The lists of the backbone, an entry a level, fit each other."""
    backbone = config.model.backbone
    levels = len(backbone.widths)
    fits = 0 < levels <= MOST_LEVELS and min(backbone.widths) >= 4 and max(backbone.widths) <= MOST_WIDTH
    sizes = f"1 to {MOST_LEVELS} numbers of 4 to {MOST_WIDTH}"
    expect(fits, "model.backbone.widths", backbone.widths, sizes)
    fits = len(backbone.blocks) == levels and min(backbone.blocks) >= 0 and max(backbone.blocks) <= MOST_DEPTH
    counts = f"{levels} numbers of 0 to {MOST_DEPTH}, one for each of model.backbone.widths"
    expect(fits, "model.backbone.blocks", backbone.blocks, counts)
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
