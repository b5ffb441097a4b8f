"""OGC: objects from rigid motion, without labels (Song and Yang 2022); written from the equations.

A network gives every point soft masks. Points of one mask must move as one rigid body between two frames (`dynamic`),
near points should share their mask (`smooth`), and masks must not depend on the position of the scene (`invariant`).

Deviations: the network is the contact model's U-Net on images. The feature of a mask is a learned constant, which OGC
computes from the scene. All points above the table are objects. The flow is estimated from the two frames by
`scene_flow`, once. `smooth` and `invariant` have lower weights and start later: objects move only a few centimetres,
and with OGC's weights (0.1) all points soon share one mask.
"""

import math
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from torch import Tensor, nn

from obpose.contact.components import image_components
from obpose.contact.config import OgcConfig
from obpose.contact.images import Images
from obpose.contact.model import ContactModel
from obpose.contact.motion.key_frames import follow_objects
from obpose.contact.motion.tracking import COLOUR_SCALE, Cloud, Followed, register
from obpose.data.clips import ClipSource
from obpose.errors import UsageError
from obpose.geometry import full_precision
from obpose.model.attention.given import Labels
from obpose.types import Observation, Segmentation

NEAREST, BALL = (8, 0.02, 3.0), (16, 0.04, 1.0)
"""Neighbours of the smoothness loss: number, largest distance in metres, weight."""
LEAST = 6
"""Components of fewer pixels have no flow of their own."""
DYNAMIC, SMOOTH, INVARIANT = 10.0, 0.02, 0.02
"""Weights of the losses."""
DYNAMIC_ALONE = 0.5
"""Share of the budget in which only `dynamic` counts."""
FEATURES, TEMPERATURE = 32, 0.05
"""Length of the features of pixels and masks, and the temperature of their cosines."""


class Ogc(ContactModel):
    """U-Net whose features give masks of the points above the table, trained on pairs of neighbouring frames.

    At evaluation the masks of single images are followed through the clip, as in the contact model.
    """

    observation_type = Observation
    config: OgcConfig

    def __init__(self, config: OgcConfig):
        """Build the network with fresh weights from PyTorch's global generator."""
        super().__init__(config)
        self.mask_features = nn.Parameter(torch.randn(config.model.slots, FEATURES))

    @property
    def channels(self) -> int:
        """Number of features of a pixel."""
        return FEATURES

    def training_source(self, source: ClipSource) -> ClipSource:
        """Give the clips themselves.

        Raises:
            UsageError: they have a single frame.
        """
        if source.frames_of_clip < 2:
            raise UsageError("The clips have one frame; expected two or more, as OGC learns from motion. Choose clips.")
        return source

    def masks(self, images: Images) -> Float[Tensor, "image slot height width"]:
        """Soft masks, which sum to one at each pixel."""
        features = self.network(images.inputs()).float()
        cosines = F.cosine_similarity(features[:, None], self.mask_features[:, :, None, None], dim=2)
        return (cosines / TEMPERATURE).softmax(dim=1)

    def standing(self, images: Images) -> Bool[Tensor, "image height width"]:
        """Pixels above the table."""
        return images.valid & (images.points[:, 2] > self.config.model.floor)

    def losses(
        self, observation: Observation, *, step: int, fraction: float = 0.0, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Compute the losses of pairs of frames, in both directions."""
        images = self.images(observation)
        masks, other, standing = self.masks(images), self.masks(_posed(images, generator)), self.standing(images)
        dynamic, smooth, invariant = [], [], []
        points = images.points.movedim(1, -1)
        rgb = images.rgb.movedim(1, -1)
        # Pairs of neighbouring frames, in both directions.
        for first in range(0, len(points), 2):
            for one, two in ((first, first + 1), (first + 1, first)):
                if not standing[one].any():
                    continue
                places, colours, above = (
                    (value[one].detach().cpu().numpy(), value[two].detach().cpu().numpy())
                    for value in (points, rgb, standing)
                )
                flow = scene_flow(places, colours, above, gap=self.config.model.gap)
                place, here = points[one][standing[one]], masks[one][:, standing[one]]
                dynamic.append(dynamic_loss(place, torch.from_numpy(flow).to(place), here))
                smooth.append(smoothness_loss(place, here))
                invariant.append(invariance_loss(here, other[one][:, standing[one]]))
        # Weighted sum; motion alone counts at first.
        terms = {
            name: torch.stack(values).mean() if values else masks.sum() * 0
            for name, values in (("dynamic", dynamic), ("smooth", smooth), ("invariant", invariant))
        }
        total = DYNAMIC * terms["dynamic"]
        if fraction >= DYNAMIC_ALONE:
            total = total + SMOOTH * terms["smooth"] + INVARIANT * terms["invariant"]
        return {"total": total, **{name: term.detach() for name, term in terms.items()}}

    def label_objects(self, observation: Observation) -> Labels:
        """Give the labels of `segment`."""
        return self.segment(observation).labels

    @torch.no_grad()
    def segment(self, observation: Observation) -> Segmentation:
        """Label objects over whole clips; `attention` holds the largest masks of single images."""
        images, points, colours = self.images_and_points(observation)
        standing = self.standing(images).cpu().numpy()
        single = (self.masks(images).argmax(dim=1).cpu().numpy() + 1) * standing
        # Foreground points and objects of each image.
        clouds = [Cloud(p[seen], COLOUR_SCALE * c[seen]) for p, c, seen in zip(points, colours, standing, strict=True)]
        objects = [found[seen] - 1 for found, seen in zip(single, standing, strict=True)]
        # Follow the objects through each clip.
        over_time, count = np.zeros_like(single), len(single) // len(observation.depth)
        for first in range(0, len(single), count):
            clip = slice(first, first + count)
            for image, found in enumerate(follow_objects(clouds[clip], objects[clip], gap=self.config.model.gap)):
                over_time[first + image][standing[first + image]] = found + 1
        shape, valid = observation.depth.shape, observation.valid
        return Segmentation(
            labels=torch.from_numpy(over_time).view(shape).to(valid.device) * valid,
            attention=torch.from_numpy(single).view(shape).to(valid.device) * valid,
        )


def _posed(images: Images, generator: torch.Generator | None) -> Images:
    """Turn each scene about the vertical and scale it, at random."""
    draw = torch.rand(2, len(images.points), generator=generator, device=images.points.device)
    angle, scale = (2 * draw[0] - 1) * math.pi, 0.9 + 0.2 * draw[1]
    c, s, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    turn = torch.stack([c, -s, zero, s, c, zero, zero, zero, one], dim=-1).view(-1, 3, 3)
    points, normals = (_turned(value, turn) for value in (images.points, images.normals))
    return replace(images, points=points * scale[:, None, None, None], normals=normals)


@full_precision
def _turned(
    vectors: Float[Tensor, "image 3 height width"], turn: Float[Tensor, "image 3 3"]
) -> Float[Tensor, "image 3 height width"]:
    return torch.einsum("nij,njhw->nihw", turn, vectors)


@full_precision
def rigid_motions(
    points: Float[Tensor, "point 3"], moved: Float[Tensor, "point 3"], masks: Float[Tensor, "slot point"]
) -> tuple[Float[Tensor, "slot 3 3"], Float[Tensor, "slot 3"]]:
    """Rotation and translation of each slot that best map points to moved points, weighted by its mask (Kabsch)."""
    weights = masks / masks.sum(dim=1, keepdim=True).clamp(min=1e-6)
    one, two = weights @ points, weights @ moved
    spread = torch.einsum("kp,kpi,kpj->kij", weights, points - one[:, None], moved - two[:, None])
    u, _, vt = torch.linalg.svd(spread)
    sign = torch.ones_like(one)
    sign[:, 2] = torch.linalg.det(vt.mT @ u.mT).sign()
    rotation = vt.mT @ (sign[:, :, None] * u.mT)
    return rotation, two - torch.einsum("kij,kj->ki", rotation, one)


@full_precision
def dynamic_loss(
    points: Float[Tensor, "point 3"], moved: Float[Tensor, "point 3"], masks: Float[Tensor, "slot point"]
) -> Float[Tensor, ""]:
    """Mean distance between the flow's end and the blend of the slots' rigid motions; only masks get gradients."""
    with torch.no_grad():
        rotation, translation = rigid_motions(points, moved, masks)
        rigid = torch.einsum("kij,pj->kpi", rotation, points) + translation[:, None]
    return (torch.einsum("kp,kpi->pi", masks, rigid) - moved).norm(dim=1).mean()


def smoothness_loss(points: Float[Tensor, "point 3"], masks: Float[Tensor, "slot point"]) -> Float[Tensor, ""]:
    """Weighted mean L1 difference between the masks of neighbouring points."""
    distances = torch.cdist(points, points)
    total = masks.new_zeros(())
    for count, reach, weight in (NEAREST, BALL):
        near, index = distances.topk(min(count, len(points)), largest=False)
        difference = (masks[:, index] - masks[:, :, None]).abs().sum(dim=0) * (near < reach)
        total = total + weight * difference.mean()
    return total


def invariance_loss(masks: Float[Tensor, "slot point"], other: Float[Tensor, "slot point"]) -> Float[Tensor, ""]:
    """Mean L1 difference between masks of the same points in two poses of the scene, slots matched one to one."""
    cost = torch.cdist(masks.detach(), other.detach(), p=1)
    rows, columns = linear_sum_assignment(cost.cpu().numpy())
    return (masks[torch.from_numpy(rows)] - other[torch.from_numpy(columns)]).abs().sum(dim=0).mean()


def scene_flow(
    points: tuple[Float[np.ndarray, "height width 3"], Float[np.ndarray, "height width 3"]],
    rgb: tuple[Float[np.ndarray, "height width 3"], Float[np.ndarray, "height width 3"]],
    standing: tuple[Bool[np.ndarray, "height width"], Bool[np.ndarray, "height width"]],
    *,
    gap: float,
) -> Float[np.ndarray, "point 3"]:
    """Estimate where the points above the table of one frame are in another, without labels.

    Connected components are registered rigidly to the other frame. The end of each point is the mean of its registered
    place and of the point of the other frame that is nearest to it in place and colour, so that parts that move apart
    leave the motion of their component.
    """
    clouds = [Cloud(p[s], COLOUR_SCALE * c[s]) for p, c, s in zip(points, rgb, standing, strict=True)]
    ends = clouds[0].points.copy()
    if not len(clouds[1].points):
        return ends
    parts = image_components(points[0], standing[0], gap=gap, least=LEAST)[standing[0]]
    objects = {int(name): Followed(clouds[0].part(parts == name), np.zeros(3)) for name in np.unique(parts[parts > 0])}
    _, _, predicted = register(clouds[1], objects)
    for name, places in predicted.items():
        ends[parts == name] = places
    nearest = KDTree(clouds[1].features).query(np.hstack([ends, clouds[0].colours]))[1]
    return (ends + clouds[1].points[nearest]) / 2
