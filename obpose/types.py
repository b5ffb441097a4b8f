"""Values that the parts of the model pass to each other.

Axes in this package: batch, frame, view, height, width; `point`: the cells of the embedding grid of all views of a
frame, view by view and row by row; `slot`: the objects; `component`: the background (first) and the slots; `ray`:
pixels at which fields are evaluated; `sample`: points of one slot. World frame and metres unless noted otherwise.
"""

from dataclasses import dataclass, fields, replace
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

Draw = Literal["sample", "mean"]
"""Source of latents: a sample of the posterior, or its mean."""

# Arrays that many parts pass to each other, by their axes.
GridPoints = Float[Tensor, "batch frame point 3"]
GridValid = Bool[Tensor, "batch frame point"]
Prescope = Float[Tensor, "batch frame point 2"]
"""Log of s^p: the background's mask, then the scope s_0 that the objects share."""
ComponentMasks = Float[Tensor, "batch frame component point"]
SlotMasks = Float[Tensor, "batch frame slot point"]
Active = Bool[Tensor, "batch slot"]
RayPoints = Float[Tensor, "batch frame ray 3"]
RayValues = Float[Tensor, "batch frame ray"]
ComponentRays = Float[Tensor, "batch frame component ray"]


@dataclass(frozen=True, eq=False)
class Observation:
    """RGB-D clips of several scenes: items of `obpose.data.datasets.SceneDataset` with a batch axis."""

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
        """Copy to another device."""
        return replace(self, **{field.name: getattr(self, field.name).to(device) for field in fields(self)})


@dataclass(frozen=True, eq=False)
class LabelledObservation(Observation):
    """RGB-D clips with labels, only for models with this `obpose.trainable.Trainable.observation_type`."""

    segmentation: Int[Tensor, "batch frame view height width"]
    """Object ids, 0 = background."""


@dataclass(frozen=True, eq=False)
class PastedObservation(Observation):
    """Single images with pseudo-objects that were pasted next to each other (`obpose.contact.pasting`)."""

    pseudo_labels: Int[Tensor, "batch frame view height width"]
    """Pseudo-objects, 0 = background. They come from the geometry of the images, not from labels."""


@dataclass(frozen=True, eq=False)
class ContactObservation(PastedObservation):
    """Clips with their pseudo-objects, the same over time, and for each clip some pasted images."""

    pasted_rgb: Float[Tensor, "batch image height width 3"]
    pasted_depth: Float[Tensor, "batch image height width"]
    pasted_labels: Int[Tensor, "batch image height width"]
    pasted_k: Float[Tensor, "batch image 3 3"]
    pasted_world_from_camera: Float[Tensor, "batch image 4 4"]

    @property
    def clips(self) -> PastedObservation:
        """The clips alone."""
        return PastedObservation(**{each.name: getattr(self, each.name) for each in fields(PastedObservation)})

    @property
    def pasted(self) -> PastedObservation:
        """The pasted images, each as a clip of one frame and view."""
        rgb, depth, labels = (
            each.flatten(0, 1)[:, None, None] for each in (self.pasted_rgb, self.pasted_depth, self.pasted_labels)
        )
        k, poses = (each.flatten(0, 1)[:, None] for each in (self.pasted_k, self.pasted_world_from_camera))
        return PastedObservation(rgb, depth, depth > 0, k, poses, labels)


@dataclass(frozen=True, eq=False)
class Embeddings:
    """Embeddings of the points of the grid (paper, section Encoder)."""

    points: Float[Tensor, "batch frame point 3"]
    """Surface points, world frame, metres; 0 where not valid."""
    valid: Bool[Tensor, "batch frame point"]
    """Whether the point was observed."""
    position: Float[Tensor, "batch frame point 3"]
    """Position, -1..1 in the workspace; its middle where not valid."""
    rgb: Float[Tensor, "batch frame point 3"]
    """Observed colour, standardised."""
    colour: Float[Tensor, "batch frame point colour"]
    """zeta_c, for the IC-SBP; without channels if there is none."""
    features: Float[Tensor, "batch frame point feature"]
    """zeta_f for the other encoders, and the standardised colours if wanted."""
    scene: Float[Tensor, "batch frame scene"]
    """One code of the whole frame, for the background; without channels if there is none."""
    log_prescope: Float[Tensor, "batch frame point 2"] | None
    """Log of s^p: the background's mask, then the scope s_0 that the objects share. None without a pre-scope."""


@dataclass(frozen=True, eq=False)
class Masks:
    """Soft attention masks. At each point the masks and the remaining scope sum to one."""

    log_masks: Float[Tensor, "batch frame component point"]
    """Log of the masks, the background's first."""
    log_scope: Float[Tensor, "batch frame point"]
    """Log of s_K, the scope that no slot has taken."""
    active: Bool[Tensor, "batch slot"]
    """Whether a slot is in use; the masks of inactive slots are 0 (their logs very negative) throughout the clip."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """Cubes of the objects: centre, orientation and edge."""

    center: Float[Tensor, "batch frame slot 3"]
    """T, in the world, metres."""
    rotation: Float[Tensor, "batch frame slot 3 3"]
    """R, world from object."""
    size: float
    """s, metres."""


@dataclass(frozen=True, eq=False)
class Latent:
    """Sequence of Gaussian latents, each with the prior that was predicted from the latents before it."""

    z: Float[Tensor, "*shape latent"]
    """Value that is used: a sample, or the mean."""
    mean: Float[Tensor, "*shape latent"]
    std: Float[Tensor, "*shape latent"]
    prior_mean: Float[Tensor, "*shape latent"]
    prior_std: Float[Tensor, "*shape latent"]


@dataclass(frozen=True, eq=False)
class Rays:
    """Pixels at which the fields are evaluated. Losses are their weighted means."""

    index: Int[Tensor, "batch frame ray"]
    """Index of the pixel among those of all views of the frame, view by view, row by row."""
    valid: Bool[Tensor, "batch frame ray"]
    """Whether its depth was observed."""
    weight: Float[Tensor, "batch frame ray"]
    """0 where not valid; 1 if all pixels were equally likely to be drawn, otherwise the inverse sampling probability,
    up to a factor."""
    colour: Float[Tensor, "batch frame ray 3"]
    """sRGB in 0..1."""
    origin: Float[Tensor, "batch frame ray 3"]
    """Camera centre."""
    direction: Float[Tensor, "batch frame ray 3"]
    """Vector from the camera to the surface, per metre of planar depth (not of unit length)."""
    depth: Float[Tensor, "batch frame ray"]
    """Planar z of the surface, metres; a positive number also where not valid."""


@dataclass(frozen=True, eq=False)
class Decoded:
    """The fields at one point of each ray."""

    logits: Float[Tensor, "batch frame component ray"]
    """Density logits sigma_k; `obpose.model.nerf.compose.OUTSIDE` outside a slot's box and for inactive slots."""
    colours: Float[Tensor, "batch frame component ray 3"] | None
    """c_k in 0..1; None if only densities were requested."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Centres of the objects, from the voxels of their fields."""

    center: Float[Tensor, "batch frame slot 3"]
    """T_shape: midpoint of the occupied voxels' bounding box, world frame, metres."""
    found: Bool[Tensor, "batch frame slot"]
    """Whether enough voxels are occupied for a meaningful centre."""


@dataclass(frozen=True, eq=False)
class Inference:
    """Result of inference on a clip, which `obpose.model.obpose.ObPose.decode` turns into densities and colours."""

    embeddings: Embeddings
    masks: Masks
    observed_center: Float[Tensor, "batch frame slot 3"]
    """T: mean of the observed points, weighted by the mask; of `obpose-contact` the middle of the smallest box."""
    boxes: Boxes
    """Boxes with centre T_hat and rotation R."""
    where: Latent | None
    """Shape batch frame slot; None without pose conditioning."""
    what: Latent
    """Shape batch frame slot."""
    background: Latent | None
    """Shape batch frame; None without such a component."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Labels of every pixel: 0 for the background and for pixels without depth, then the slots from 1 on."""

    labels: Int[Tensor, "batch frame view height width"]
    """The labels that are scored; ObPose's are the argmax of the composed density at the observed surface."""
    attention: Int[Tensor, "batch frame view height width"]
    """Second segmentation, for comparison: argmax of the attention masks, upsampled. Of `contact-masks`: the groups of
    each image on its own; of `obpose-contact`: the argmax of the composed density."""


@dataclass(frozen=True, eq=False)
class SceneSegmentation(Segmentation):
    """Labels with the inference they come from."""

    inference: Inference
