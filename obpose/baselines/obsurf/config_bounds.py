"""Bounds of ObSuRF's configuration values."""

from obpose.baselines.obsurf.config import ObsurfConfig
from obpose.config_bounds import (
    MOST_DEPTH,
    MOST_FIELD_WIDTH,
    SLOTS,
    TRAINING,
    Rule,
    at_most,
    check_values,
    counts,
    expect,
    not_negative,
    positive,
)

MOST_WIDTH, MULTIPLE = 512, 4
"""Largest width of the encoder, and its divisor: the number of heads and of the groups of its norms."""

_RULES: tuple[Rule, ...] = (
    *TRAINING,
    *SLOTS,
    counts("model.encoder.width model.decoder.width"),
    at_most("model.encoder.width", MOST_WIDTH),
    at_most("model.decoder.width", MOST_FIELD_WIDTH),
    ("model.encoder.width", lambda value: value % MULTIPLE == 0, f"a multiple of {MULTIPLE}"),
    ("model.encoder.cell", lambda value: value in (2, 4), "2 or 4"),
    (
        "model.encoder.blocks",
        lambda blocks: 0 <= blocks[0] <= MOST_DEPTH and 1 <= blocks[1] <= MOST_DEPTH,
        f"0 to {MOST_DEPTH}, and 1 to {MOST_DEPTH}",
    ),
    # 2^k turns in single precision.
    ("model.last_octave", lambda value: -5 <= value <= 24, "-5 to 24"),
    positive("model.units_per_metre loss.colour_std"),
    not_negative("loss.overlap loss.overlap_start"),
)


def check_obsurf_bounds(config: ObsurfConfig) -> None:
    """Check that a configuration can be built and trained.

    Raises:
        UsageError: a value is out of bounds; the message names the first one and what is expected.
    """
    check_values(config, _RULES)
    start, full = config.loss.overlap_start, config.loss.overlap_full
    expect(full > start, "loss.overlap_full", full, f"more than loss.overlap_start, which is {start}")
    warmup, views = config.train.warmup, config.train.views
    expect(warmup == 0, "train.warmup", warmup, "0, as ObSuRF has no background to warm up")
    expect(views != "all", "train.views", views, "random or separate, as ObSuRF encodes single images")
