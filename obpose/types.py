"""The values that the parts of the model hand to each other.

Axes in this package: batch, frame, view, height, width; `point`: the cells of the embedding grid of all views
of a frame, view by view and row by row; `slot`: the objects; `component`: the background (first) and the slots; `ray`:
pixels at which fields are evaluated; `sample`: points of one slot. World frame and metres unless said.
"""

from dataclasses import dataclass, fields, replace
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

Draw = Literal["sample", "mean"]
"""Whether latents are drawn from their posterior or stand at its mean."""


@dataclass(frozen=True, eq=False)
class Observation:
    """RGB-D clips of several scenes, as `obpose.data.datasets.SceneDataset` gives them, with a batch axis."""

    rgb: Float[Tensor, "batch frame view height width 3"]
    """sRGB in 0..1."""
    depth: Float[Tensor, "batch frame view height width"]
    """Planar z in metres, 0 where there is no return."""
    valid: Bool[Tensor, "batch frame view height width"]
    """Whether the pixel has a depth."""
    k: Float[Tensor, "batch view 3 3"]
    """Camera matrices in pixels, pixel centres at +0.5."""
    world_from_camera: Float[Tensor, "batch view 4 4"]
    """Poses of the cameras with OpenCV axes, metres."""

    def to(self, device: torch.device | str) -> "Observation":
        """The same on another device."""
        return replace(self, **{field.name: getattr(self, field.name).to(device) for field in fields(self)})


@dataclass(frozen=True, eq=False)
class LabelledObservation(Observation):
    """The same with labels: only for models that say that they see them (`obpose.trainable.Trainable.sees`)."""

    segmentation: Int[Tensor, "batch frame view height width"]
    """Object ids, 0 = background."""


@dataclass(frozen=True, eq=False)
class Embeddings:
    """What the backbone says of the points of the embedding grid (paper, section Encoder)."""

    points: Float[Tensor, "batch frame point 3"]
    """World frame, metres; 0 where not valid."""
    valid: Bool[Tensor, "batch frame point"]
    """Whether the point was observed."""
    rgb: Float[Tensor, "batch frame point 3"]
    """Observed colour, standardised."""
    colour: Float[Tensor, "batch frame point colour"]
    """zeta_c, for the IC-SBP; without channels where there is none."""
    features: Float[Tensor, "batch frame point feature"]
    """zeta_f, and the observed colours if wanted, for the other encoders."""
    scene: Float[Tensor, "batch frame scene"]
    """One code of the whole frame, for the background."""


@dataclass(frozen=True, eq=False)
class Masks:
    """Soft attention masks of the IC-SBP. At each point the masks and the remaining scope sum to one."""

    log_masks: Float[Tensor, "batch frame component point"]
    """Log of the masks, the background's first."""
    log_scope: Float[Tensor, "batch frame point"]
    """Log of s_K, what no slot has taken."""
    active: Bool[Tensor, "batch slot"]
    """Slots in use; an idle one has mask 0 (its log is very negative) throughout the clip."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """The objects' cubes: where, how turned, and the length of an edge."""

    center: Float[Tensor, "batch frame slot 3"]
    """T, in the world, metres."""
    rotation: Float[Tensor, "batch frame slot 3 3"]
    """R, world from object."""
    size: float
    """s, metres."""


@dataclass(frozen=True, eq=False)
class Latent:
    """A sequence of Gaussian latents with the prior that was predicted for each from those before it."""

    z: Float[Tensor, "*shape latent"]
    """What is passed on: a sample, or the mean."""
    mean: Float[Tensor, "*shape latent"]
    std: Float[Tensor, "*shape latent"]
    prior_mean: Float[Tensor, "*shape latent"]
    prior_std: Float[Tensor, "*shape latent"]


@dataclass(frozen=True, eq=False)
class Rays:
    """Pixels at which the fields are evaluated. Losses are their weighted means."""

    index: Int[Tensor, "batch frame ray"]
    """Place of the pixel among those of all views of the frame, view by view, row by row."""
    valid: Bool[Tensor, "batch frame ray"]
    """Whether its depth was observed."""
    weight: Float[Tensor, "batch frame ray"]
    """0 where not valid; 1 where all pixels were equally likely to be drawn, else the smaller the likelier."""
    colour: Float[Tensor, "batch frame ray 3"]
    """sRGB in 0..1."""
    origin: Float[Tensor, "batch frame ray 3"]
    """Camera centre."""
    direction: Float[Tensor, "batch frame ray 3"]
    """From the camera to the surface, per metre of planar depth (not of unit length)."""
    depth: Float[Tensor, "batch frame ray"]
    """Planar z of the surface, metres; a positive number also where not valid."""


@dataclass(frozen=True, eq=False)
class Decoded:
    """The fields at one point of each ray."""

    logits: Float[Tensor, "batch frame component ray"]
    """Density logits sigma_k; `obpose.model.nerf.compose.OUTSIDE` outside a slot's box and for idle slots."""
    colours: Float[Tensor, "batch frame component ray 3"] | None
    """c_k in 0..1; None where only densities were asked for."""


@dataclass(frozen=True, eq=False)
class Shape:
    """What the voxels of the objects' fields tell of them."""

    center: Float[Tensor, "batch frame slot 3"]
    """T_shape: midpoint of the occupied voxels' bounding box, world frame, metres."""
    found: Bool[Tensor, "batch frame slot"]
    """Whether enough voxels are occupied for it to mean something."""


@dataclass(frozen=True, eq=False)
class Inference:
    """What the model infers from a clip; `model.decode` turns it into densities and colours anywhere."""

    embeddings: Embeddings
    masks: Masks
    observed_center: Float[Tensor, "batch frame slot 3"]
    """T: mean of the observed points, weighted by the mask."""
    boxes: Boxes
    """At T_hat, with R."""
    where: Latent | None
    """Shape batch frame slot; None without pose conditioning."""
    what: Latent
    """Shape batch frame slot."""
    background: Latent | None
    """Shape batch frame; None without such a component."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Labels of every pixel: 0 = background, or nothing was observed; 1.. = slots."""

    labels: Int[Tensor, "batch frame view height width"]
    """What counts; of ObPose the argmax of the composed density at the observed surface."""
    attention: Int[Tensor, "batch frame view height width"]
    """Argmax of the attention masks, upsampled."""


@dataclass(frozen=True, eq=False)
class SceneSegmentation(Segmentation):
    """Labels with what they came of."""

    inference: Inference
