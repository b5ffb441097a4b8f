"""Configuration of ObSuRF, with the source of each default.

`[code]`: the ObSuRF authors' published code, its configuration for CLEVR-3D; `[ours]`: our choice. The defaults are
sizes for minutes on a CPU core, the profile `paper` has the published ones.
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
    """Residual blocks at half of the image's resolution and at that of the grid. [code: 2 and 6]"""
    cell: int = 2
    """Height of a cell of the grid in pixels, 2 or 4. [code: 4, of images with 240 rows]"""
    points: bool = False
    """Whether pixels' surface points are an input beside the rays. [ours; ObPose's paper says that its ObSuRF had
    depth, but neither its code nor ObSuRF's shows how]"""


@dataclass(frozen=True)
class DecoderConfig:
    """Field of a slot."""

    width: int = 64
    """Channels of the hidden layers. [code: 128]"""
    unit_scales: bool = False
    """Whether the slots' scales are initialised to 1. [ours; published they are small at first, and fresh logits of
    different points differ by about a thousandth]"""
    pixel_features: bool = True
    """Whether colours depend on the image's features at a point's pixel. [code]"""


@dataclass(frozen=True)
class ObsurfModelConfig:
    """The architecture."""

    slots: int = 4
    """Number of objects; the model has one slot more, none of which is declared to be the background."""
    encoder: ImageEncoderConfig = field(default_factory=ImageEncoderConfig)
    decoder: DecoderConfig = field(default_factory=DecoderConfig)
    last_octave: int = 3
    """Points and camera positions p, in units, are encoded by sin and cos of 2^k pi p up to this k. [ours: a quarter of
    a unit; code: 10, a period of 1/512 of a unit]"""
    workspace_center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Middle of the observed points, world frame, metres; measured before training
    (`obpose.data.scene_stats.measure_scene`)."""
    units_per_metre: float = 10.0
    """Length of a metre in units of CLEVR. Edges of CLEVR's objects are 0.7 to 1.4 units, ours 5 to 28 cm. [ours; in
    `clevr3d` a unit of CLEVR is 0.1 m]"""

    @property
    def segments(self) -> int:
        """Number of slots, that of the background included."""
        return self.slots + 1


@dataclass(frozen=True)
class ObsurfLossConfig:
    """Loss terms; terms are means over rays, as published."""

    overlap: float = 0.05
    """Weight of the overlap loss; 0 omits the term. [code]"""
    overlap_start: float = 0.2
    """Share of the budget after which the weight of the overlap loss grows from 0. [code: 20,000 steps, of the 100,000
    that ObPose's authors make with it]"""
    overlap_full: float = 0.4
    """Share of the budget at which the weight of the overlap loss reaches its value. [code: 40,000 steps]"""
    colour_std: float = 0.2
    """Standard deviation of a colour. [code]"""


@dataclass(frozen=True)
class ObsurfConfig:
    """All settings of a run, except for its data.

    `train.warmup` must be 0, and `train.views` must not be `all`. Large gradients are clipped. The published code skips
    such steps, but here all gradients are large, and a run that skips them makes no progress.
    """

    model: ObsurfModelConfig = field(default_factory=ObsurfModelConfig)
    loss: ObsurfLossConfig = field(default_factory=ObsurfLossConfig)
    train: TrainConfig = field(
        default_factory=lambda: TrainConfig(
            batch=4,
            frames=2,
            object_rays=0.0,
            decay="halving",  # [code: in 100,000 steps, all that ObPose's authors make with it]
            warmup=0,
        )
    )


OBSURF_VARIANTS: dict[str, dict[str, Any]] = {
    "obsurf": {},
    "obsurf-no-overlap": {"loss.overlap": 0.0},
    "obsurf-no-overlap-depth": {"loss.overlap": 0.0, "model.encoder.points": True},
}
"""Configuration changes of each variant, by dotted name."""

OBSURF_SEARCHED: dict[str, dict[str, Any]] = {
    "obsurf": {"train.learning_rate": 3e-3, "model.decoder.unit_scales": True},
    "obsurf-no-overlap-depth": {"train.learning_rate": 3e-3, "train.object_rays": 0.5},
}
"""Further changes in the profile `cpu`, chosen for it by the declared search (docs/results/search.md)."""

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
"""Configuration changes of each size: minutes on a CPU core, 20 minutes on a large GPU, the authors' for CLEVR-3D."""
