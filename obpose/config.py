"""Every constant of the model, the losses and the training, with where it comes from.

`[paper]`: stated there; `[code]`: the authors' published code; `[ours]`: our addition or choice, see
docs/paper.md. Variants and sizes, which change some of them, stand in `obpose/variants.py`.
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
    """Channels a level; each level has half the resolution of the one before. [code]"""
    blocks: tuple[int, ...] = (0, 1, 1, 1)
    """Residual blocks a level, beside the one that goes down to it. [code: 1, 2, 2, 2]"""
    radius: float = 2.0
    """Radius of a KPConv neighbourhood in units of the distance between neighbouring points of the level.
    [ours, that of a 3x3 window; code: 0.025 m where points are some 6 mm apart, then both doubled]"""
    output_level: int = 0
    """Level of the grid of embeddings; level l has every 2^l-th point. [paper: 1, of images twice as fine as in the
    profile `cpu`: either way 64x64 points]"""
    embedding: int = 16
    """D. [code]"""
    colour: int = 8
    """D_c. [code]"""
    feature: int = 16
    """D_f. [code]"""
    scene_means: Literal["given", "none"] = "given"
    """Whether means of all levels and the mean colour stand beside the KPConv in the code of an image. [ours; code:
    none]"""


@dataclass(frozen=True)
class AttentionConfig:
    """From embeddings to masks; all but the first is of the IC-SBP."""

    kind: Literal["icsbp", "slots"] = "icsbp"
    """Masks of the IC-SBP, or of slot attention, whose slots take the place of the object encoder. [paper: both]"""
    kernel: Literal["gaussian", "laplacian", "epanechnikov"] = "gaussian"
    """psi. [code: gaussian]"""
    semi_convolution: float = 8.0
    """World position in metres, times this, is added to the first three channels of the colour embedding; 0 for none.
    What matters most for learning in few steps. [ours; Novotny et al. 2018]"""
    semi_colour: float = 0.3
    """Standardised colour, times this, is added to the next three channels; 0 for none. [ours]"""
    seeds: Literal["stochastic", "greedy"] = "stochastic"
    """In training: seed at the argmax of u * scope with u uniform (GENESIS-V2), or of the scope. [code: stochastic]"""
    evaluation_seeds: Literal["greedy", "densest"] = "densest"
    """At evaluation: seed at the largest scope, or where the scope around is largest. [ours]"""
    evaluation_division: Literal["sticks", "shares"] = "shares"
    """At evaluation: what several slots reach goes to the first of them first, or to the nearest. In training sticks
    are broken always. [ours; paper: sticks]"""
    looks: int = 3
    """So often a seed moves to the mean embedding under its mask, in each frame; 0: it stays where it was chosen.
    [ours; paper: 0]"""
    mask_power: float = 3.0
    """Means over points, which are where seeds go and where objects are, weigh each by its mask to this power. [ours;
    code: 1]"""
    evaluation_rounds: int = 1
    """At evaluation masks are so often replaced by the posterior of which component a point is of, given the fields
    that were read under them; poses and latents are then read anew. [ours; paper: 0]"""
    idle_in_training: Literal["never", "bernoulli"] = "never"
    """Whether a slot is left out when a draw of the remaining scope finds no point. [code: bernoulli]"""
    idle_points: int = 2
    """At evaluation a slot is idle unless so many points of the first frame have a remaining scope over `idle_scope`; 0
    for no idle slots. [ours]"""
    idle_scope: float = 0.7


@dataclass(frozen=True)
class SlotAttentionConfig:
    """Slot attention (Locatello et al. 2020), as in the paper's ablation."""

    iterations: int = 3
    """In each frame. [code]"""
    width: int = 32
    """Of a slot. [code]"""
    distribution: Literal["learned", "untrained"] = "learned"
    """Mean and deviation from which slots are drawn: parameters, or numbers of which nothing is learned or saved, and
    others at evaluation than in training. [Locatello et al.: learned; code: untrained, by mistake]"""
    position_frequencies: int = 1
    """Sines and cosines of 2^i pi p, for i below this, that tokens hear of beside the position p, which is -1..1 in the
    workspace. [ours; code: 0]"""


@dataclass(frozen=True)
class PoseConfig:
    """Boxes of the objects and the `where` module."""

    conditioning: Literal["world", "none", "location", "full"] = "full"
    """Objects are encoded in the workspace's frame, at their location, or at location and orientation, and are nowhere
    else; `world`: as `none`, but their fields fill the whole world, like the background's. [paper; its baselines:
    world]"""
    points: Literal["own", "all"] = "own"
    """An object encoder sees the points of the box at which no other slot's mask is larger, or all. [ours; code:
    all]"""
    box_size: float = 0.2
    """s, metres. [code: 0.4]"""
    max_translation: float = 0.05
    """T_max, metres. [code: 0.1]"""
    min_points: int = 1
    """With fewer points of the embedding grid whose argmax is the slot, its location is kept from the frame before.
    [ours; code: 10 of 64x64]"""
    min_pixels: int = 10
    """With fewer pixels whose argmax is the slot, its orientation is that of the frame before or the identity.
    [code: 10 points]"""
    grid_level: int = 1
    """HEALPix level of the rotation grid before refinement; of its 576 (1) or 4608 (2) rotations are used the 24 or 204
    that a box's symmetry does not turn into each other. [code: 3, all 36,864]"""
    refinements: int = 8
    """Rounds of local refinement; the last one turns boxes by at most 0.6 degrees. [ours]"""
    tolerance: float = 0.01
    """beta: boxes up to 1 + beta times the smallest are candidates. [code]"""


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
    """Points of the box given to an object encoder. [ours; code: all]"""
    summary: Literal["points", "mean"] = "points"
    """An object's code: of an encoder of its points, or the mean of features and positions under its mask. [paper:
    points; code of its IC-SBP ablation: mean]"""
    radius: float = 0.5
    """Of a neighbourhood in the object encoder; half the box's edge is 1. [ours; code: 0.025, in which each point is
    alone]"""
    frequencies: int = 3
    """Sines and cosines of 2^i pi p, for i below this, that the object encoder gets beside the position p. [ours; code:
    0]"""
    colours: Literal["given", "none"] = "given"
    """Whether the observed colours stand beside zeta_f. [ours; code: none]"""
    means: Literal["given", "none"] = "given"
    """Whether the mean of the features under the mask, for slot attention of positions too, ends an object's code as it
    is. [ours; code: none]"""
    posterior_std: float = 0.01
    """Standard deviation typical of a fresh posterior. [ours; code: 0.7]"""
    posterior_input: Literal["state and code", "state"] = "state and code"
    """What a posterior is read from: the recurrent cell's state, and the frame's code beside it. [ours; code: state]"""


@dataclass(frozen=True)
class FieldConfig:
    """One NeRF."""

    width: int = 64
    """[code: 128]"""
    depth: int = 4
    """Hidden layers; the latent and the position enter again after the middle one. [code: 8]"""
    position_frequencies: int = 6
    """sin and cos of 2^i pi p for i below this. [code: 10]"""
    direction_frequencies: int = 2
    """The same for view directions. [code: 4]"""
    density: Literal["raw", "squashed"] = "raw"
    """The density logit: what the network gives, or 10 times its sigmoid, with which no point can be empty. [paper:
    raw; code of its slot attention for video: squashed]"""


@dataclass(frozen=True)
class ModelConfig:
    """The architecture."""

    slots: int = 4
    """K, without the background. [code]"""
    background: Literal["component", "none"] = "component"
    """A component with a field of its own; or none: then K + 1 slots are equal, and the IC-SBP's last one takes the
    remaining scope. [paper; GENESIS-V2: none]"""
    weights: Weights = "orthogonal"
    """Fresh weights from the encoders' codes to the fields: orthogonal, by which inputs stay as far apart as they are,
    or PyTorch's own. [ours; code: uniform]"""
    backbone: BackboneConfig = field(default_factory=BackboneConfig)
    attention: AttentionConfig = field(default_factory=AttentionConfig)
    slot_attention: SlotAttentionConfig = field(default_factory=SlotAttentionConfig)
    pose: PoseConfig = field(default_factory=PoseConfig)
    latent: LatentConfig = field(default_factory=LatentConfig)
    object_field: FieldConfig = field(default_factory=FieldConfig)
    background_field: FieldConfig = field(default_factory=lambda: FieldConfig(width=48))
    spacing: float = 0.012
    """Distance in metres between the surface points of neighbouring pixels of the full image, median over training
    images; measured before training (`obpose.measure.measure_scene`)."""
    workspace_center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Middle of the observed points, world frame, metres; measured before training."""
    workspace_size: float = 1.0
    """Edge of the cube around it that holds the observed points, metres; measured before training."""
    background_size: float = 2.0
    """Edge of the cube around it that holds the cameras as well, metres; measured before training. The background's
    positional encoding repeats itself outside."""
    voxels: int = 12
    """S: voxels along each edge of a box. [code: 24]"""
    voxel_threshold: float = 0.5
    """sigma_T. [code]"""
    floor: float | None = -0.002
    """Voxels below this height above the world's z = 0 are not the object's, metres; None for no floor. [code]"""
    table: float | None = 0.001
    """Objects have no density below this height above the world's z = 0, metres; None for no such limit. Without it
    objects explain their shadows. [ours]"""


@dataclass(frozen=True)
class LossConfig:
    """Terms and their weights. Terms are means over rays, points or frames, where the paper has sums."""

    sigma_max: float = 10.0
    """Density of an opaque point. [code]"""
    colour_std: float = 0.1
    """sigma_std. [code]"""
    colour_likelihood: Literal["channel", "joint"] = "channel"
    """A mixture in each colour channel, or one over the three together. [code: channel]"""
    attention: Literal["mixture", "l2"] = "mixture"
    """[paper: both; code: mixture]"""
    attention_floor: float = -18.0
    """Log of the likelihood of an outlier in the mixture attention loss. [ours]"""
    unknown: float = 0.0
    """Log of the likelihood, in each colour channel, of what is not background, in the warm-up. [ours]"""
    colour: float = 1.0
    surface: float = 1.0
    air: float = 1.0
    air_growth: float = 1.0
    """What the weight of the air is multiplied with in the last quarter of the budget, growing from its middle on:
    fields get sharper surfaces, once they have found their objects. [ours]"""
    mask: float = 1.0
    """Weight of the attention loss; 5 suits `l2`."""
    scope: float = 0.25
    """[paper: 1, with sums over the embedding grid, which has a quarter of the image's points]"""
    translation: float = 1.0
    """[paper: 1, with sums over rays, beside which it is thousands of times lighter than here]"""
    kl: float = 1 / 4096
    """Of z_what and z_bg. [paper: 1, with sums over rays]"""
    kl_where: float = 1e-3 / 4096
    """[code: 1e-3 of the other]"""
    jitter: float = 0.01
    """Colour and density are fitted up to this far behind the surface, metres of planar depth. [code]"""
    air_saturation: float | None = 3.0
    """Summed softplus beyond which density in the air goes on as a straight line, which has a gradient; None: it stays
    a tanh. [ours; paper: none]"""
    near_share: float = 0.98
    """Half of the air points lie before this share of the depth, half behind. [code]"""


@dataclass(frozen=True)
class TrainConfig:
    """How it is trained."""

    batch: int = 1
    """Clips a step; as many more as they are shorter than `frames`, so that a step sees as many images."""
    frames: int = 5
    """Frames of a training window; whole clips where they are shorter. [code]"""
    rays: int = 256
    """Pixels a frame at which the fields are evaluated, over all views; 0 for all. [ours]"""
    object_rays: float = 0.5
    """Share of the rays drawn where objects are expected, less than 1; weights make up for it. The pre-scope says
    where, and without one the largest component: where it is not. [ours]"""
    learning_rate: float = 1e-3
    """[paper: 4e-4]"""
    decay: Literal["cosine", "halving", "none"] = "cosine"
    """`cosine`: to zero at the end of the budget; `halving`: smoothly to a half, again and again. [paper: none]"""
    half_life: float = 0.1
    """Share of the budget in which `halving` halves. [ObSuRF's code: 100,000 of at most a million steps]"""
    clip: float = 1.0
    """Largest norm of the gradient; 0 for no clipping. [ours]"""
    skip: float = 0.0
    """After the first tenth of the budget, steps whose gradient has a larger norm than this, before clipping, change
    nothing; 0 for none. A run whose gradients stay larger stands still. [ObSuRF's code: 200, from a hundredth of its
    million steps on, and weights of before where many are skipped in a row]"""
    warmup: int = 150
    """Steps that train the background and the pre-scope alone, first. [ours]"""
    minutes: float = 23.0
    """Budget in minutes: of CPU time of the process on a CPU, of time of day on a GPU; only training steps count."""
    steps: int | None = None
    """Budget in steps, in the place of minutes."""
    views: Views = "one"
    """The views of a frame are one point cloud; or the model sees one of them, drawn at random, and rays of all of them
    supervise it; or they are scenes of their own. Only the first segments them together. [ours, as in ObSuRF, so that
    all systems see the same; code: apart]"""
    precision: Literal["32-true", "bf16-mixed"] = "32-true"
    """Of the arithmetic in training; segmentations are always computed with 32 bits. [ours]"""
    seed: int = 0


@dataclass(frozen=True)
class Config:
    """Everything that a run depends on, beside its data."""

    model: ModelConfig = field(default_factory=ModelConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    train: TrainConfig = field(default_factory=TrainConfig)


@dataclass(frozen=True)
class SupervisedConfig(Config):
    """The same for `obpose.supervised`, for which many values have no meaning: those of latents, fields and losses."""


ADDED_LATER = frozenset({"loss.air_growth", "model.backbone.scene_means"})
"""Values that the configurations of weights that ship do not all state; where they are missing the default is meant.

Whoever adds a value to a configuration adds its name here, if weights from before are to be read still. Any other value
that is missing in a file means that the file is damaged.
"""


def override(config: Any, changes: dict[str, Any]) -> Any:
    """A configuration with some values replaced, named with dots.

    Raises:
        KeyError: no such name.
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
