"""OGC: objects from rigid motion, without labels (Song and Yang 2022); written from the equations.

A network gives every point soft masks. Points of one mask must move as one rigid body between two frames (`dynamic`),
near points should share their mask (`smooth`), and masks must not depend on the position of the scene (`invariant`).

Deviations: the network is the contact model's U-Net on images, all points above the table are objects, and the flow is
estimated from the two frames by `scene_flow`, once.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from torch import Tensor

from obpose.contact.components import image_components
from obpose.contact.tracking import COLOUR_SCALE, Cloud, Followed, register

NEAREST, BALL = (8, 0.02, 3.0), (16, 0.04, 1.0)
"""Neighbours of the smoothness loss: number, largest distance in metres, weight."""
LEAST = 6
"""Components of fewer pixels have no flow of their own."""


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
    """Where the points that stand on the table in one frame are in the other, without labels.

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
