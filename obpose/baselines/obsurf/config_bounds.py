"""Which values of ObSuRF's configuration make sense."""

from obpose.baselines.obsurf.config import ObsurfConfig
from obpose.config_bounds import (
    MOST_DEPTH,
    MOST_FIELD_WIDTH,
    MOST_ROUNDS,
    MOST_WIDTH,
    TRAINING,
    Rule,
    at_most,
    between_0_and_1,
    check_values,
    counts,
    expect,
    not_negative,
    positive,
)

_RULES: tuple[Rule, ...] = (
    counts(
        """model.slots model.encoder.width model.attention.iterations model.attention.heads model.decoder.width
        model.decoder.depth"""
    ),
    at_most("model.encoder.width", MOST_WIDTH),
    at_most("model.decoder.width", MOST_FIELD_WIDTH),
    at_most("model.decoder.depth", MOST_DEPTH),
    at_most("model.attention.iterations model.attention.heads", MOST_ROUNDS),
    # 2^k turns in single precision.
    at_most("model.last_octave", 24),
    ("model.first_octave", lambda value: value >= -24, "-24 or more"),
    positive("model.sigma_max model.units_per_metre loss.colour_std"),
    not_negative("loss.colour loss.surface loss.air loss.overlap loss.overlap_start loss.jitter"),
    between_0_and_1("loss.near_share"),
    ("train.warmup", lambda value: value == 0, "0, as ObSuRF has no background to warm up"),
    ("train.views", lambda value: value != "together", "one or apart, as ObSuRF encodes single images"),
)


def check_obsurf_bounds(config: ObsurfConfig) -> None:
    """Let a configuration pass only if a model can be made of it and trained.

    Raises:
        UsageError: names the first value that is out of bounds, and what is expected.
    """
    check_values(config, (*TRAINING, *_RULES))
    model, loss = config.model, config.loss
    heads = f"a multiple of 4 and of model.attention.heads, which is {model.attention.heads}"
    divides = model.encoder.width % 4 == 0 and model.encoder.width % model.attention.heads == 0
    expect(divides, "model.encoder.width", model.encoder.width, heads)
    blocks = model.encoder.blocks
    fits = 0 <= blocks[0] <= MOST_DEPTH and 1 <= blocks[1] <= MOST_DEPTH
    expect(fits, "model.encoder.blocks", blocks, f"0 to {MOST_DEPTH}, and 1 to {MOST_DEPTH}")
    more = f"more than loss.overlap_start, which is {loss.overlap_start}"
    expect(loss.overlap_full > loss.overlap_start, "loss.overlap_full", loss.overlap_full, more)
    expect(model.encoder.cell in (2, 4), "model.encoder.cell", model.encoder.cell, "2 or 4")
    octaves = f"at least model.first_octave, which is {model.first_octave}"
    expect(model.last_octave >= model.first_octave, "model.last_octave", model.last_octave, octaves)
