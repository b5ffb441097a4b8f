"""Every constant of ObSuRF, of its losses and its training, with where it comes from.

`[code]`: the ObSuRF authors' published code, its configuration for CLEVR-3D; `[ours]`: our choice. Lengths are in units
of CLEVR, of which our objects are as many long as CLEVR's. The defaults are sizes that learn in minutes on a CPU core,
the profile `paper` the published ones.
"""

from dataclasses import dataclass, field
from typing import Any

from obpose.config import TrainConfig


@dataclass(frozen=True)
class ImageEncoderConfig:
    """Residual convolutions from an image with its rays to a grid of features."""

    width: int = 48
    """Channels of every layer, of the features and of the slots. [code: 128]"""
    blocks: tuple[int, int] = (1, 1)
    """Residual blocks at a half of the image's resolution and at that of the grid. [code: 2 and 6]"""
    cell: int = 2
    """Height of a cell of the grid in pixels, 2 or 4. [code: 4, of images with 240 rows]"""
    points: bool = False
    """Whether pixels' surface points stand beside the rays: depth as an input. [ours; ObPose's paper says that its
    ObSuRF had depth, its code and ObSuRF's do not show how]"""


@dataclass(frozen=True)
class SlotConfig:
    """Slot attention."""

    iterations: int = 5
    """[code]"""
    heads: int = 4
    """Of the self-attention between slots after each iteration. [code]"""


@dataclass(frozen=True)
class DecoderConfig:
    """The field of a slot."""

    width: int = 64
    """[code: 128]"""
    depth: int = 4
    """Hidden layers. [code]"""
    unit_scales: bool = False
    """Whether the slots' scales begin at 1. [ours; published they begin small, and fresh logits of different points
    differ by about a thousandth]"""
    pixel_features: bool = True
    """Whether colours see the image's features at a point's pixel. [code]"""


@dataclass(frozen=True)
class ObsurfModelConfig:
    """The architecture."""

    slots: int = 4
    """Objects; one slot more is made, for the background, though none is told to be it."""
    encoder: ImageEncoderConfig = field(default_factory=ImageEncoderConfig)
    attention: SlotConfig = field(default_factory=SlotConfig)
    decoder: DecoderConfig = field(default_factory=DecoderConfig)
    first_octave: int = -5
    """Points and camera positions are encoded by sin and cos of 2^k pi p from this k, p in units, [code]"""
    last_octave: int = 3
    """to this one. [code: 10, a period of 1/512 of a unit; ours: a quarter of a unit]"""
    sigma_max: float = 10.0
    """Largest density of a slot, per unit. [code]"""
    workspace_center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Middle of the observed points, world frame, metres; measured before training (`measure_scene`)."""
    units_per_metre: float = 10.0
    """Edges of CLEVR's objects are 0.7 to 1.4 units, ours 5 to 28 cm. [ours; in `clevr3d` a unit of CLEVR is 0.1 m]"""


@dataclass(frozen=True)
class ObsurfLossConfig:
    """Terms and their weights; terms are means over rays, as published."""

    colour: float = 1.0
    surface: float = 1.0
    air: float = 1.0
    """[code: `surface` and `air` are one term]"""
    overlap: float = 0.05
    """0 leaves the term out. [code]"""
    overlap_start: float = 0.2
    """Share of the budget after which the weight of the overlap grows from 0, [code: 20,000 steps, of the 100,000 that
    ObPose's authors make with it]"""
    overlap_full: float = 0.4
    """and at which it reaches its value. [code: 40,000]"""
    colour_std: float = 0.2
    """[code]"""
    jitter: float = 0.07
    """Colour and density are fitted up to this far behind the surface, units of planar depth. [code: along the ray]"""
    near_share: float = 0.98
    """Half of the air points lie before this share of the depth, half behind. [code]"""


@dataclass(frozen=True)
class ObsurfConfig:
    """Everything that a run depends on, beside its data.

    Of `train`, `warmup` must be 0, and views are not together. Steps with large gradients are clipped but not skipped,
    as they are in the published code: here they all are large, and a run that skips them stands still.
    """

    model: ObsurfModelConfig = field(default_factory=ObsurfModelConfig)
    loss: ObsurfLossConfig = field(default_factory=ObsurfLossConfig)
    train: TrainConfig = field(
        default_factory=lambda: TrainConfig(
            batch=4,
            frames=2,
            rays=256,
            object_rays=0.0,
            learning_rate=1e-3,
            decay="halving",
            half_life=1.0,  # [code: 100,000 steps, all that ObPose's authors make with it]
            clip=1.0,
            warmup=0,
        )
    )


OBSURF_VARIANTS: dict[str, dict[str, Any]] = {
    "obsurf": {},
    "obsurf-no-overlap": {"loss.overlap": 0.0},
    "obsurf-no-overlap-depth": {"loss.overlap": 0.0, "model.encoder.points": True},
}
"""What each variant changes, by dotted name."""

OBSURF_SEARCHED: dict[str, dict[str, Any]] = {
    "obsurf": {"train.learning_rate": 3e-3, "model.decoder.unit_scales": True},
    "obsurf-no-overlap-depth": {"train.learning_rate": 3e-3, "train.object_rays": 0.5},
}
"""What variants change besides in the profile `cpu`, for which the declared search chose it (docs/results.md)."""

OBSURF_PROFILES: dict[str, dict[str, Any]] = {
    "cpu": {},
    "gpu": {
        "model.encoder.width": 128,
        "model.encoder.blocks": (2, 2),
        "model.decoder.width": 128,
        "model.last_octave": 5,
        "train.batch": 16,
        "train.rays": 1024,
    },
    "paper": {
        "model.encoder.width": 128,
        "model.encoder.blocks": (2, 6),
        "model.encoder.cell": 4,
        "model.decoder.width": 128,
        "model.last_octave": 10,
        "train.batch": 64,
        "train.frames": 1,
        "train.rays": 4096,
        "train.learning_rate": 4e-4,
    },
}
"""Sizes: minutes on a CPU core, 20 minutes on a large GPU, the authors' for CLEVR-3D."""
