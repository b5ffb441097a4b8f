"""Configuration of the model, the losses and the training, with the source of each default.

`[paper]`: stated in the paper; `[code]`: the authors' published code; `[ours]`: our addition or choice, see
docs/paper.md. Only values that a variant, a profile or a dataset changes are configurable; the other constants stand
beside the code that uses them. Variants and profiles are in `obpose/variants.py`.
"""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal

Weights = Literal["orthogonal", "uniform"]
Views = Literal["all", "random", "separate"]
Conditioning = Literal["world", "none", "location", "full"]


@dataclass(frozen=True)
class BackboneConfig:
    """U-Net of KPConv layers on the organised point cloud."""

    blocks: tuple[int, ...] = (0, 1, 1, 1)
    """Residual blocks of each level, not counting the downsampling block. [code: 1, 2, 2, 2]"""
    output_level: int = 0
    """Level of the grid of embeddings; level l has every 2^l-th point. [paper: 1, of images twice as fine as in the
    profile `cpu`: either way 64x64 points]"""
    scene_means: Literal["given", "none"] = "given"
    """Whether the code of an image also contains means of all levels and the mean colour, beside the KPConv. [ours;
    code: none]"""


@dataclass(frozen=True)
class AttentionConfig:
    """Attention, which turns embeddings into masks. `slot_distribution` is for slot attention, the rest for IC-SBP."""

    kind: Literal["icsbp", "slots", "given"] = "icsbp"
    """Source of the masks: IC-SBP; slot attention, whose slots replace the object encoder; or a segmentation that is
    `given` by another model, only for `obpose-contact`. [paper: the first two; ours: given]"""
    semi_convolution: float = 8.0
    """World position in metres, times this, is added to the first three channels of the colour embedding; 0 for none.
    The most important setting for learning in few steps. [ours; Novotny et al. 2018]"""
    semi_colour: float = 0.3
    """Standardised colour, times this, is added to the next three channels; 0 for none. [ours]"""
    mean_shift_steps: int = 3
    """Mean-shift steps per seed and frame; 0 keeps seeds where they were chosen. [ours; paper: 0]"""
    mask_exponent: float = 3.0
    """Exponent of the masks where they weight points in a mean, as for seeds and object locations. [ours; code: 1]"""
    evaluation_seeds: Literal["greedy", "densest"] = "densest"
    """At evaluation: seed at the largest scope, or at the point whose neighbourhood has the largest summed scope.
    [ours]"""
    evaluation_division: Literal["stick_breaking", "softmax"] = "softmax"
    """At evaluation: points within reach of several slots go mostly to the first slot (`stick_breaking`) or to the
    nearest one (`softmax`). Training always uses stick breaking. [ours; paper: stick_breaking]"""
    posterior_refinements: int = 1
    """Refinement rounds at evaluation. Each replaces the masks by the posterior over components at each point, given
    the decoded fields, then infers poses and latents again. [ours; paper: 0]"""
    inactive_in_training: Literal["never", "bernoulli"] = "never"
    """In training: whether a slot is inactive if a Bernoulli draw from the remaining scope selects no point. [code:
    bernoulli]"""
    inactive_points: int = 2
    """At evaluation: a slot is inactive if fewer points than this have a large remaining scope in the first frame; 0
    for no inactive slots. [ours]"""
    slot_distribution: Literal["learned", "untrained"] = "learned"
    """Mean and deviation from which slots are drawn: `learned` parameters, or `untrained` random numbers that are not
    saved and differ between training and evaluation. [Locatello et al.: learned; code: untrained, by mistake]"""


@dataclass(frozen=True)
class PoseConfig:
    """Boxes of the objects."""

    conditioning: Conditioning = "full"
    """Frame in which objects are encoded: the workspace's (`none`), at their `location`, or at location and orientation
    (`full`). Fields end at the box. `world`: as `none`, but fields fill the whole world, like the background's.
    [paper; its baselines: world]"""
    points: Literal["own", "all"] = "own"
    """Input of an object encoder: the points of the box at which no other slot's mask is larger, or all of its points.
    [ours; code: all]"""
    box_size: float = 0.2
    """s: edge of a box, metres. [code: 0.4]"""
    max_translation: float = 0.05
    """T_max: largest offset of a box from the centre of its observed points, per axis, metres. [code: 0.1]"""


@dataclass(frozen=True)
class LatentConfig:
    """Object encoders and latents."""

    samples: int = 160
    """Number of points of the box given to an object encoder. [ours; code: all]"""
    radius: float = 0.5
    """Radius of a neighbourhood in the object encoder, in units of half the box's edge. [ours; code: 0.025, where
    neighbourhoods hold a single point]"""
    frequencies: int = 3
    """Number of frequencies: the object encoder gets sin and cos of 2^i pi p, for i below this, beside the position p.
    [ours; code: 0]"""
    colours: Literal["given", "none"] = "given"
    """Whether the object encoder gets the observed colours beside the features zeta_f. [ours; code: none]"""
    means: Literal["given", "none"] = "given"
    """Whether the mean of the features under the mask is appended to an object's code; with slot attention, the mean
    position too. [ours; code: none]"""
    posterior_std: float = 0.01
    """Typical standard deviation of the posterior before training. [ours; code: 0.7]"""
    posterior_input: Literal["state and code", "state"] = "state and code"
    """Input of the posterior: the recurrent cell's state, with or without the code of the frame. [ours; code: state]"""


@dataclass(frozen=True)
class FieldConfig:
    """A NeRF, of the objects or of the background."""

    width: int = 64
    """Channels of the hidden layers. [code: 128]"""
    depth: int = 4
    """Number of hidden layers; latent and position enter again after the middle one. [code: 8]"""
    position_frequencies: int = 6
    """Number of frequencies: positions p are encoded by sin and cos of 2^i pi p for i below this. [code: 10]"""
    direction_frequencies: int = 2
    """Number of frequencies of view directions. [code: 4]"""
    density: Literal["raw", "squashed"] = "raw"
    """Density logit: the output of the network, or 10 times its sigmoid, with which no point can be empty. [paper:
    raw; code of its slot attention for video: squashed]"""


@dataclass(frozen=True)
class ModelConfig:
    """The architecture."""

    slots: int = 4
    """K: number of slots, without the background. [code]"""
    background: Literal["component", "none"] = "component"
    """Model of the background: a `component` with its own field; or `none`, where K + 1 slots are alike and the last
    slot of the IC-SBP takes the remaining scope. [paper; GENESIS-V2: none]"""
    weights: Weights = "orthogonal"
    """Initial weights between the encoders' codes and the fields: `orthogonal`, which preserves distances between
    inputs, or PyTorch's default (`uniform`). [ours; code: uniform]"""
    backbone: BackboneConfig = field(default_factory=BackboneConfig)
    attention: AttentionConfig = field(default_factory=AttentionConfig)
    pose: PoseConfig = field(default_factory=PoseConfig)
    latent: LatentConfig = field(default_factory=LatentConfig)
    object_field: FieldConfig = field(default_factory=FieldConfig)
    background_field: FieldConfig = field(default_factory=lambda: FieldConfig(width=48))
    spacing: float = 0.012
    """Distance in metres between the surface points of neighbouring pixels of the full image, median over training
    images; measured before training (`obpose.data.scene_stats.measure_scene`)."""
    workspace_center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Middle of the observed points, world frame, metres; measured before training."""
    workspace_size: float = 1.0
    """Edge of the cube around `workspace_center` that holds the observed points, metres; measured before training."""
    background_size: float = 2.0
    """Edge of the cube around `workspace_center` that also holds the cameras, metres; measured before training. Outside
    of it the background's positional encoding repeats."""
    voxels: int = 12
    """S: voxels along each edge of a box. [code: 24]"""
    table: float | None = 0.001
    """Height in metres above the world's z = 0 below which objects have no density; None for no limit. Without a limit
    objects include their shadows. The table's surface is 1 mm lower. [ours]"""

    @property
    def table_top(self) -> float:
        """Height of the table's surface, world frame, metres: 1 mm below `table`, and 0 without that limit."""
        return 0.0 if self.table is None else self.table - 0.001

    @property
    def has_background(self) -> bool:
        """Whether the background is a component with its own field."""
        return self.background == "component"

    @property
    def segments(self) -> int:
        """Number of components, the background included: the count of datasets and of the benchmark."""
        return self.slots + 1

    @property
    def object_components(self) -> int:
        """Number of components besides a background component."""
        return self.slots if self.has_background else self.segments


@dataclass(frozen=True)
class LossConfig:
    """Loss terms. Terms are means over rays, points or frames; the paper has sums."""

    attention: Literal["mixture", "l2"] = "mixture"
    """Attention loss: the mixture likelihood or a squared distance. [paper: both; code: mixture]"""
    attention_weight: float = 1.0
    """Weight of the attention loss; 5 suits `l2`."""
    attention_floor: float = -18.0
    """Log-likelihood of an outlier in the mixture attention loss. [ours]"""
    translation: float = 1.0
    """Weight of the translation loss. [paper: 1, with sums over rays, where its relative weight is thousands of times
    smaller than here]"""
    air_growth: float = 1.0
    """Factor on the air term in the last quarter of the budget; it grows from 1 in the quarter before. Surfaces get
    sharper once the objects are found. [ours]"""
    air_saturation: float | None = 3.0
    """Summed softplus beyond which the density in the air continues as a straight line, to keep a gradient; None: tanh
    everywhere. [ours; paper: none]"""


@dataclass(frozen=True)
class TrainConfig:
    """Settings of the training."""

    batch: int = 1
    """Clips in a step. If clips are shorter than `frames`, a step has proportionally more of them."""
    frames: int = 5
    """Frames of a training window; shorter clips are used whole. [code]"""
    rays: int = 256
    """Pixels per frame at which the fields are evaluated, over all views; 0 for all. [ours]"""
    object_rays: float = 0.5
    """Share of the rays drawn where objects are expected, less than 1; weights correct for it. Objects are expected by
    the pre-scope, or without one outside of the largest component. [ours]"""
    learning_rate: float = 1e-3
    """Learning rate of Adam at first, or once it has risen. [paper: 4e-4]"""
    decay: Literal["cosine", "halving", "none"] = "cosine"
    """Learning rate schedule. `cosine`: to zero at the end of the budget; `halving`: exponential, to a half at its end.
    [paper: none]"""
    rise: float = 0.0
    """Share of the budget over which the learning rate rises from 0, linearly; the schedule of `decay` multiplies it.
    [ours]"""
    clip: float = 1.0
    """Largest norm of the gradient; 0 for no clipping. [ours]"""
    warmup: int = 150
    """Initial steps that train only the background and the pre-scope. [ours]"""
    minutes: float = 23.0
    """Budget in minutes: CPU time of the process on a CPU, wall time on a GPU; only training steps count."""
    steps: int | None = None
    """Budget in steps, instead of minutes."""
    views: Views = "random"
    """Use of several views of a frame. `all`: they form one point cloud; `random`: the model sees one random view, and
    rays of all views supervise it; `separate`: each is a separate scene. Only `all` segments them jointly. [ours, as
    in ObSuRF, so that all systems have the same input; code: separate]"""
    precision: Literal["32-true", "bf16-mixed"] = "32-true"
    """Precision of the arithmetic in training; segmentations are always computed with 32 bits. [ours]"""
    seed: int = 0


@dataclass(frozen=True)
class Config:
    """All settings of a run, except for its data."""

    model: ModelConfig = field(default_factory=ModelConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    train: TrainConfig = field(default_factory=TrainConfig)


def override(config: Any, changes: dict[str, Any]) -> Any:
    """Give a configuration with some values replaced, by dotted name.

    Raises:
        KeyError: a name is unknown.
    """
    for name, value in changes.items():
        config = _replace(config, name.split("."), value)
    return config


def _replace(config: Any, names: list[str], value: Any) -> Any:
    first, *rest = names
    if not dataclasses.is_dataclass(config) or first not in {field.name for field in dataclasses.fields(config)}:
        raise KeyError(f"{type(config).__name__} has no {first!r}.")
    inner = _replace(getattr(config, first), rest, value) if rest else value
    return dataclasses.replace(config, **{first: inner})  # pyright: ignore[reportArgumentType]
