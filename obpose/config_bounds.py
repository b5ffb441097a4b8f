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


def at_most(names: str, limit: int) -> Rule:
    """Rule: at most `limit`, set by memory or by a reasonable duration."""
    return names, lambda value: value <= limit, f"at most {limit}"


MOST_STEPS, MOST_MINUTES = 10**9, 5_256_000
"""Largest budgets of a training, in steps and in minutes (ten years)."""
MOST_IMAGES = 4096
"""Largest number of images in a step; activations of more do not fit into memory."""
MOST_FIELD_WIDTH, MOST_DEPTH, MOST_ROUNDS = 1024, 16, 100
"""Largest sizes. A model with all of them has a few hundred megabytes of weights; the paper's have a few megabytes."""
LEVELS = 4
"""Number of levels of the backbone, as in `obpose.model.backbone.WIDTHS`, which is not imported as it needs PyTorch."""

TRAINING: tuple[Rule, ...] = (
    counts("train.batch train.frames train.steps"),
    at_most("train.batch train.frames", MOST_IMAGES),
    at_most("train.rays", 1_000_000),
    at_most("train.steps", MOST_STEPS),
    at_most("train.minutes", MOST_MINUTES),
    positive("train.learning_rate train.minutes"),
    not_negative("train.rays train.clip train.warmup"),
    ("train.seed", lambda value: 0 <= value < 2**63, "0 or more, and less than 2^63"),
    ("train.object_rays train.rise", lambda value: 0 <= value < 1, "0 or more, and less than 1"),
)
"""Rules for the training of every architecture."""
SLOTS: tuple[Rule, ...] = (
    # Label images have 8 bits: the background, and at most 254 objects.
    counts("model.slots"),
    at_most("model.slots", 254),
)
"""Rules for architectures with a fixed number of slots."""

_FIELDS = ("model.object_field", "model.background_field")
_FREQUENCIES = " ".join(
    [
        "model.latent.frequencies",
        *(f"{each}.{axis}_frequencies" for each in _FIELDS for axis in ("position", "direction")),
    ]
)
_WIDTHS, _DEPTHS = (" ".join(f"{each}.{size}" for each in _FIELDS) for size in ("width", "depth"))
_ROUNDS = "model.attention.mean_shift_steps model.attention.posterior_refinements"

_RULES: tuple[Rule, ...] = (
    *TRAINING,
    *SLOTS,
    counts(f"model.voxels model.latent.samples {_WIDTHS} {_DEPTHS}"),
    positive(
        "model.pose.box_size model.spacing model.workspace_size model.background_size loss.air_growth "
        "loss.air_saturation model.attention.mask_exponent model.latent.radius model.latent.posterior_std"
    ),
    not_negative(
        f"model.attention.semi_convolution model.attention.semi_colour {_ROUNDS} model.attention.inactive_points "
        f"model.pose.max_translation {_FREQUENCIES} loss.attention_weight loss.translation"
    ),
    # 2^k turns in single precision.
    at_most(_FREQUENCIES, 24),
    at_most(_WIDTHS, MOST_FIELD_WIDTH),
    at_most(_DEPTHS, MOST_DEPTH),
    at_most(_ROUNDS, MOST_ROUNDS),
    # Their cube is the number of points at which a field is evaluated at once.
    at_most("model.voxels", 128),
    at_most("model.latent.samples", 1_000_000),
)


def check_bounds(config: Config) -> None:
    """Check that a configuration can be built and trained.

    Raises:
        UsageError: a value is out of bounds; the message names the first one and what is expected.
    """
    check_values(config, _RULES)
    blocks, level = config.model.backbone.blocks, config.model.backbone.output_level
    fits = len(blocks) == LEVELS and min(blocks) >= 0 and max(blocks) <= MOST_DEPTH
    expect(fits, "model.backbone.blocks", blocks, f"{LEVELS} numbers of 0 to {MOST_DEPTH}")
    expect(0 <= level < LEVELS, "model.backbone.output_level", level, f"0 to {LEVELS - 1}")
    _check_parts(config)


def check_values(config: Any, rules: Iterable[Rule]) -> None:
    """Check the values of a configuration of any architecture against rules, and that all numbers are finite.

    Raises:
        UsageError: a value breaks a rule; the message names the first one.
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
"""Largest magnitude of a float, in any unit, so that products of a few stay finite."""


def expect(holds: bool, name: str, value: Any, expected: str) -> None:
    """Check a condition on a configuration value.

    Raises:
        UsageError: the condition does not hold; the message says what was expected.
    """
    if not holds:
        raise UsageError(f"{name} is {value!s:.80}; expected {expected}.")


def _check_parts(config: Config) -> None:
    """Check that the parts of the model fit each other."""
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
        rounds = model.attention.posterior_refinements
        expect(rounds == 0, "model.attention.posterior_refinements", rounds, "0, as slot attention has no posteriors")
