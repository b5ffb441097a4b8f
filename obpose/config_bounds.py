"""Which values of a configuration make sense: bounds that their types cannot say, looked at before anything is made."""

import math
from collections.abc import Callable
from functools import reduce
from typing import Any

from obpose.config import Config
from obpose.config_text import dotted_values
from obpose.errors import UsageError

_COUNTS = """model.slots model.voxels model.backbone.input_stride model.backbone.embedding model.backbone.feature
model.latent.where model.latent.what model.latent.background model.latent.hidden model.latent.encoder
model.latent.samples model.object_field.width model.object_field.depth model.background_field.width
model.background_field.depth train.batch train.frames train.steps"""
_POSITIVE = """model.backbone.radius model.pose.box_size model.spacing model.workspace_size model.background_size
loss.sigma_max loss.colour_std train.learning_rate train.minutes"""
_NOT_NEGATIVE = """model.attention.semi_convolution model.attention.semi_colour model.attention.looks
model.attention.idle_points model.pose.max_translation model.pose.min_points model.pose.min_pixels
model.pose.grid_level model.pose.refinements model.pose.tolerance model.object_field.position_frequencies
model.object_field.direction_frequencies model.background_field.position_frequencies
model.background_field.direction_frequencies loss.colour loss.surface loss.air loss.mask loss.scope loss.translation
loss.kl loss.kl_where loss.jitter train.rays train.clip train.warmup"""


def check_bounds(config: Config) -> None:
    """Let a configuration pass only if a model can be made of it and trained.

    Raises:
        UsageError: names the first value that is out of bounds, and what is expected.
    """
    for name, value in dotted_values(config):
        _expect(not (isinstance(value, float) and math.isnan(value)), name, value, "a number")
    for names, holds, expected in (
        (_COUNTS, lambda value: value >= 1, "1 or more"),
        (_POSITIVE, lambda value: 0 < value < math.inf, "more than 0, and finite"),
        (_NOT_NEGATIVE, lambda value: 0 <= value < math.inf, "0 or more, and finite"),
        ("train.seed", lambda value: 0 <= value < 2**63, "0 or more, and less than 2^63"),
        ("train.object_rays", lambda value: 0 <= value < 1, "0 or more, and less than 1"),
        ("loss.near_share", lambda value: 0 < value < 1, "between 0 and 1"),
        ("model.attention.idle_scope", lambda value: 0 < value < 1, "between 0 and 1"),
        # The position is added to three of them, the colour to three more.
        ("model.backbone.colour", lambda value: value >= 6, "6 or more"),
    ):
        _check_each(config, names, holds, expected)
    _check_levels(config)


def _check_each(config: Config, names: str, holds: Callable[[Any], bool], expected: str) -> None:
    for name in names.split():
        value = reduce(getattr, name.split("."), config)
        _expect(value is None or holds(value), name, value, expected)


def _check_levels(config: Config) -> None:
    """The lists of the backbone, an entry a level, fit each other."""
    backbone = config.model.backbone
    levels = len(backbone.widths)
    _expect(levels > 0 and min(backbone.widths) > 0, "model.backbone.widths", backbone.widths, "positive numbers")
    fits = len(backbone.blocks) == levels and min(backbone.blocks) >= 0
    _expect(fits, "model.backbone.blocks", backbone.blocks, f"{levels} numbers, one for each of model.backbone.widths")
    _expect(
        0 <= backbone.output_level < levels, "model.backbone.output_level", backbone.output_level, f"0 to {levels - 1}"
    )


def _expect(holds: bool, name: str, value: Any, expected: str) -> None:
    if not holds:
        raise UsageError(f"{name} is {value}; expected {expected}.")
