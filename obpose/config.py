"""All constants of the model, the losses and the training, with their sources.

`[paper]`: stated in the paper; `[code]`: the authors' published code; `[ours]`: our addition or choice, see
docs/paper.md. Variants and sizes that change some of them are in `obpose/variants.py`.
"""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal

Weights = Literal["orthogonal", "uniform"]
Views = Literal["together", "one", "apart"]


@dataclass(frozen=True)
class BackboneConfig:
    """U-Net of KPConv layers on the organised point cloud."""

    input_stride: int = 1
    """Take every n-th pixel of the image in both directions. [ours]"""
    widths: tuple[int, ...] = (16, 32, 64, 64)
    """Channels of each level; each level has half the resolution of the previous one. [code]"""
    blocks: tuple[int, ...] = (0, 1, 1, 1)
    """Residual blocks of each level, not counting the downsampling block. [code: 1, 2, 2, 2]"""
    radius: float = 2.0
    """Radius of a KPConv neighbourhood in units of the distance between neighbouring points of the level.
    [ours, that of a 3x3 window; code: 0.025 m where points are some 6 mm apart, then both doubled]"""
    output_level: int = 0
    """Level of the grid of embeddings; level l has every 2^l-th point. [paper: 1, of images twice as fine as in the
    profile `cpu`: either way 64x64 points]"""
    embedding: int = 16
    """D: channels of the point embeddings. [code]"""
    colour: int = 8
    """D_c: channels of the colour embeddings, which the attention clusters. [code]"""
    feature: int = 16
    """D_f: channels of the features, which the encoders use. [code]"""
    scene_means: Literal["given", "none"] = "given"
    """Whether the code of an image also contains means of all levels and the mean colour, beside the KPConv. [ours;
    code: none]"""


@dataclass(frozen=True)
class AttentionConfig:
    """Attention, which turns embeddings into masks; all values but `kind` are for the IC-SBP."""

    kind: Literal["icsbp", "slots"] = "icsbp"
    """Source of the masks: the IC-SBP, or slot attention, whose slots replace the object encoder. [paper: both]"""
    kernel: Literal["gaussian", "laplacian", "epanechnikov"] = "gaussian"
    """psi: kernel of the distance between a seed and an embedding. [code: gaussian]"""
    semi_convolution: float = 8.0
    """World position in metres, times this, is added to the first three channels of the colour embedding; 0 for none.
    The most important setting for learning in few steps. [ours; Novotny et al. 2018]"""
    semi_colour: float = 0.3
    """Standardised colour, times this, is added to the next three channels; 0 for none. [ours]"""
    seeds: Literal["stochastic", "greedy"] = "stochastic"
    """In training: seed at the argmax of u * scope with u uniform in 0..1 (GENESIS-V2), or of the scope. [code:
    stochastic]"""
    evaluation_seeds: Literal["greedy", "densest"] = "densest"
    """At evaluation: seed at the largest scope, or at the point whose neighbourhood has the largest summed scope.
    [ours]"""
    evaluation_division: Literal["sticks", "shares"] = "shares"
    """At evaluation: points within reach of several slots go mostly to the first slot (`sticks`, stick breaking) or to
    the nearest one (`shares`). Training always uses `sticks`. [ours; paper: sticks]"""
    looks: int = 3
    """Mean-shift steps per seed and frame. Each moves the seed to the mean embedding under its mask; 0 keeps the seed
    where it was chosen. [ours; paper: 0]"""
    mask_power: float = 3.0
    """Exponent of the masks where they weight points in a mean, as for the seeds and the object locations. [ours;
    code: 1]"""
    evaluation_rounds: int = 1
    """Refinement rounds at evaluation. Each replaces the masks by the posterior over components at each point, given
    the decoded fields, then infers poses and latents again. [ours; paper: 0]"""
    idle_in_training: Literal["never", "bernoulli"] = "never"
    """In training: whether a slot is idle if a Bernoulli draw from the remaining scope selects no point. [code:
    bernoulli]"""
    idle_points: int = 2
    """At evaluation: a slot is idle if fewer points than this in the first frame have a remaining scope over
    `idle_scope`; 0 for no idle slots. [ours]"""
    idle_scope: float = 0.7


@dataclass(frozen=True)
class SlotAttentionConfig:
    """Slot attention (Locatello et al. 2020), as in the paper's ablation."""

    iterations: int = 3
    """Iterations in each frame. [code]"""
    width: int = 32
    """Channels of a slot. [code]"""
    distribution: Literal["learned", "untrained"] = "learned"
    """Mean and deviation from which slots are drawn: `learned` parameters, or `untrained` random numbers that are not
    saved and differ between training and evaluation. [Locatello et al.: learned; code: untrained, by mistake]"""
    position_frequencies: int = 1
    """Number of frequencies: tokens get sin and cos of 2^i pi p, for i below this, beside the position p, which is
    -1..1 in the workspace. [ours; code: 0]"""


@dataclass(frozen=True)
class PoseConfig:
    """Boxes of the objects and the `where` module."""

    conditioning: Literal["world", "none", "location", "full"] = "full"
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
    min_points: int = 1
    """A slot keeps its location from the previous frame if it has the largest mask at fewer points of the embedding
    grid than this. [ours; code: 10 of 64x64]"""
    min_pixels: int = 10
    """A slot keeps its orientation from the previous frame, initially the identity, if it has the largest mask at fewer
    pixels than this. [code: 10 points]"""
    grid_level: int = 1
    """HEALPix level of the rotation grid before refinement. Of its 576 (1) or 4608 (2) rotations, the 24 or 204 that
    are distinct under the symmetry of a box are used. [code: 3, all 36,864]"""
    refinements: int = 8
    """Rounds of local refinement; the last one rotates boxes by at most 0.6 degrees. [ours]"""
    tolerance: float = 0.01
    """beta: boxes of up to 1 + beta times the smallest volume are candidates. [code]"""


@dataclass(frozen=True)
class LatentConfig:
    """Object encoders, recurrent cells and latents."""

    where: int = 32
    """Dimensions of z_where. [code]"""
    what: int = 32
    """Dimensions of z_what. [code]"""
    background: int = 32
    """Dimensions of z_bg. [code]"""
    hidden: int = 32
    """Width of the recurrent cells. [code]"""
    encoder: int = 64
    """Width of the object encoders. [code]"""
    samples: int = 160
    """Number of points of the box given to an object encoder. [ours; code: all]"""
    summary: Literal["points", "mean"] = "points"
    """Source of an object's code: an encoder of its points, or the mean of features and positions under its mask.
    [paper: points; code of its IC-SBP ablation: mean]"""
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
    slot_attention: SlotAttentionConfig = field(default_factory=SlotAttentionConfig)
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
    voxel_threshold: float = 0.5
    """sigma_T: occupancy above which a voxel belongs to the object. [code]"""
    floor: float | None = -0.002
    """Height in metres above the world's z = 0 below which voxels do not belong to an object; None for no floor.
    [code]"""
    table: float | None = 0.001
    """Height in metres above the world's z = 0 below which objects have no density; None for no limit. Without a limit
    objects include their shadows. [ours]"""


@dataclass(frozen=True)
class LossConfig:
    """Weights and constants of the loss terms. Terms are means over rays, points or frames; the paper has sums."""

    sigma_max: float = 10.0
    """Density of an opaque point. [code]"""
    colour_std: float = 0.1
    """sigma_std: standard deviation of a component's colour. [code]"""
    colour_likelihood: Literal["channel", "joint"] = "channel"
    """Colour likelihood: one mixture in each colour channel, or one over all three. [code: channel]"""
    attention: Literal["mixture", "l2"] = "mixture"
    """Attention loss: the mixture likelihood or a squared distance. [paper: both; code: mixture]"""
    attention_floor: float = -18.0
    """Log-likelihood of an outlier in the mixture attention loss. [ours]"""
    unknown: float = 0.0
    """Log-likelihood per colour channel of foreground points during the warm-up, when there are no objects yet.
    [ours]"""
    colour: float = 1.0
    surface: float = 1.0
    air: float = 1.0
    air_growth: float = 1.0
    """Factor on `air` in the last quarter of the budget; it grows from 1 in the quarter before. Surfaces get sharper
    once the objects are found. [ours]"""
    mask: float = 1.0
    """Weight of the attention loss; 5 suits `l2`."""
    scope: float = 0.25
    """Weight of the scope loss. [paper: 1, with sums over the embedding grid, which has a quarter of the image's
    points]"""
    translation: float = 1.0
    """Weight of the translation loss. [paper: 1, with sums over rays, where its relative weight is thousands of times
    smaller than here]"""
    kl: float = 1 / 4096
    """Weight of the KL divergence of z_what and z_bg. [paper: 1, with sums over rays]"""
    kl_where: float = 1e-3 / 4096
    """Weight of the KL divergence of z_where. [code: 1e-3 times `kl`]"""
    jitter: float = 0.01
    """Distance behind the surface up to which colour and density are fitted, metres of planar depth. [code]"""
    air_saturation: float | None = 3.0
    """Summed softplus beyond which the density in the air continues as a straight line, to keep a gradient; None: tanh
    everywhere. [ours; paper: none]"""
    near_share: float = 0.98
    """Share of the depth that splits the air points: half of them lie before it, half behind. [code]"""


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
    """Initial learning rate of Adam. [paper: 4e-4]"""
    decay: Literal["cosine", "halving", "none"] = "cosine"
    """Learning rate schedule. `cosine`: to zero at the end of the budget; `halving`: exponential. [paper: none]"""
    half_life: float = 0.1
    """Share of the budget in which `halving` halves the rate. [ObSuRF's code: 100,000 of at most a million steps]"""
    clip: float = 1.0
    """Largest norm of the gradient; 0 for no clipping. [ours]"""
    skip: float = 0.0
    """Gradient norm before clipping above which a step is skipped, after the first tenth of the budget; 0 to skip none.
    If gradients stay larger, the weights no longer change. [ObSuRF's code: 200, from a hundredth of its million steps
    on; it restores earlier weights if many are skipped in a row]"""
    warmup: int = 150
    """Initial steps that train only the background and the pre-scope. [ours]"""
    minutes: float = 23.0
    """Budget in minutes: CPU time of the process on a CPU, wall time on a GPU; only training steps count."""
    steps: int | None = None
    """Budget in steps, instead of minutes."""
    views: Views = "one"
    """Use of several views of a frame. `together`: they form one point cloud; `one`: the model sees a random view, and
    rays of all views supervise it; `apart`: each is a separate scene. Only `together` segments them jointly. [ours, as
    in ObSuRF, so that all systems have the same input; code: apart]"""
    precision: Literal["32-true", "bf16-mixed"] = "32-true"
    """Precision of the arithmetic in training; segmentations are always computed with 32 bits. [ours]"""
    seed: int = 0


@dataclass(frozen=True)
class Config:
    """All settings of a run, except for its data."""

    model: ModelConfig = field(default_factory=ModelConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    train: TrainConfig = field(default_factory=TrainConfig)


@dataclass(frozen=True)
class SupervisedConfig(Config):
    """Configuration of `obpose.baselines.supervised`, which ignores the values of latents, fields and losses."""


ADDED_LATER = frozenset({"loss.air_growth", "model.backbone.scene_means"})
"""Values that may be missing in configurations of older shipped weights; a missing value means the default.

When you add a value to a configuration, add its name here if older weights should remain readable. A file that lacks
any other value is damaged.
"""


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
