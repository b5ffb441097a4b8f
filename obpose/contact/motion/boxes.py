"""Smallest boxes of objects over a clip. Points that several frames show of an object are fused by its motion.

A camera sees one side of an object. While the object turns and others move out of its way, further sides come into
view, and its box becomes that of the whole object.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from obpose.contact.motion.rigidity import REST, Motion, register
from obpose.contact.motion.tracking import COLOUR_SCALE, Cloud, Points, joined, median, outlier_limit
from obpose.model.pose.minimum_volume import orient
from obpose.model.pose.orientation import STANDING
from obpose.model.pose.rotations import equivalents

LEAST_POINTS = 12
"""Frames in which an object has fewer points are not linked with others."""
NEIGHBOURS = 8
"""Nearest points, the point itself included, that a normal is estimated from."""
FIRST_ROUNDS, ROUNDS = 6, 8
"""Rounds of registration between two frames, and then to all frames before."""
FARTHEST = 0.04
"""Points farther apart than this, metres, do not correspond."""
SCALE = 0.003
"""Residual in metres at which the weight of a point is halved."""
SLIDING = 0.02
"""Weight of distances along surfaces, relative to those along normals, which are more precise."""
FITTING = 0.002
"""Largest mean residual in metres by which a frame is linked with those before."""
STEADY = np.cos(np.radians(15))
"""Least cosine of the vertical's rotation for an object that does not turn over."""
LONGEST_STEP = 0.015
"""Longest step in metres between neighbouring pixels by which a surface is continued at its border."""


class Surface(NamedTuple):
    """Points of an object with normals of unknown sign."""

    cloud: Cloud
    normals: Points


@torch.no_grad()
def boxes_over_time(
    points: Float[Tensor, "batch frame view height width 3"],
    rgb: Float[Tensor, "batch frame view height width 3"],
    owners: Int[Tensor, "batch frame view height width"],
    boxes: tuple[Float[Tensor, "batch frame slot 3"], Float[Tensor, "batch frame slot 3 3"]],
    *,
    table: float,
) -> tuple[Float[Tensor, "batch frame slot 3"], Float[Tensor, "batch frame slot 3 3"]]:
    """T and R of every slot: the smallest box of all points that the clip shows of an object.

    Frames between which its motion is not known have boxes of their own.

    Args:
        points: Surface points, world frame, metres.
        rgb: Colours in 0..1.
        owners: Slot of each pixel, from 1, the same over time; 0 is the background.
        boxes: T and R of each frame on its own, which are kept for frames with fewer than `LEAST_POINTS` points.
        table: Height of the table, metres.
    """
    middle, rotation = (value.clone() for value in boxes)
    places, colours, labels = (value.double().cpu().numpy() for value in (points, COLOUR_SCALE * rgb, owners))
    for scene, slot in np.ndindex(len(labels), middle.shape[2]):
        # Points of the object in each frame, and just beyond its border.
        images = [*zip(places[scene], colours[scene], labels[scene] == slot + 1, strict=True)]
        clouds = [Cloud(place[own], colour[own]) for place, colour, own in images]
        seen = [cloud.points for cloud in clouds]
        whole = [np.concatenate([place[own], border_points(place, own)]) for place, _, own in images]
        # One box for each group of frames with known motions, carried along by them.
        for motions in linked_frames(clouds):
            fused = torch.from_numpy(fused_points(seen, motions, table=table))[None, None, None].to(middle)
            axes = orient(fused, torch.ones_like(fused[..., 0], dtype=torch.bool), min_points=1, tolerance=0.0)[0, 0, 0]
            local = torch.from_numpy(fused_points(whole, motions, table=table)).to(middle) @ axes
            center = axes @ (local.amin(dim=0) + local.amax(dim=0)) / 2
            for frame, motion in motions.items():
                turn, shift = (torch.from_numpy(value).to(middle) for value in motion)
                middle[scene, frame, slot], rotation[scene, frame, slot] = turn @ center + shift, turn @ axes
        # Keep the names of the axes from frame to frame.
        for frame in range(1, len(clouds)):
            rotation[scene, frame, slot] = nearest_axes(rotation[scene, frame, slot], rotation[scene, frame - 1, slot])
    return middle, rotation


def linked_frames(clouds: Sequence[Cloud]) -> list[dict[int, Motion]]:
    """Group neighbouring frames between which the motion of an object is known.

    Args:
        clouds: Points of the object in each frame.

    Returns:
        Groups in the order of time: frames, and their motions from the group's first frame. Frames with few points are
        in none.
    """
    groups: list[dict[int, Motion]] = []
    surfaces: list[Surface] = []
    last = 0
    for frame, cloud in enumerate(clouds):
        if len(cloud.points) < LEAST_POINTS:
            continue
        motion, residual = REST, np.inf
        # Register to the frame before, then to all points of the group.
        if groups:
            step = register(clouds[last], cloud, None, rounds=FIRST_ROUNDS)
            back, residual = aligned(cloud, _union(surfaces), groups[-1][last].then(step).inverse)
            motion = back.inverse
        # Begin a new group where the points do not fit.
        if residual > FITTING:
            motion, surfaces = REST, []
            groups.append({})
        groups[-1][frame], last = motion, frame
        normals = _normals(cloud.points) @ motion.rotation
        surfaces.append(Surface(motion.inverse.moved(cloud), normals))
    return groups


def aligned(cloud: Cloud, surface: Surface, motion: Motion) -> tuple[Motion, float]:
    """Refine the motion of points to a surface, by distances along its normals (Chen and Medioni 1992).

    Returns:
        The motion, and the mean residual in metres; infinite if few points are near the surface.
    """
    tree = KDTree(surface.cloud.features)
    for _ in range(ROUNDS):
        moved = motion.moved(cloud)
        distances, nearest = map(np.asarray, tree.query(moved.features))
        near = distances <= min(outlier_limit(distances), FARTHEST)
        if np.count_nonzero(near) < LEAST_POINTS:
            return motion, np.inf
        pairs = moved.points[near], surface.cloud.points[nearest[near]]
        motion = motion.then(_step(*pairs, surface.normals[nearest[near]]))
    moved = motion.moved(cloud)
    distances, nearest = map(np.asarray, tree.query(moved.features))
    residuals = np.abs(_along(moved.points - surface.cloud.points[nearest], surface.normals[nearest]))
    return motion, float(np.where(distances > FARTHEST, FARTHEST, residuals).mean())


def border_points(
    points: Float[np.ndarray, "view height width 3"], own: Bool[np.ndarray, "view height width"]
) -> Points:
    """Points half a pixel beyond the border of an object, which is where it ends on average; world frame, metres.

    They continue the surface horizontally, by half of the step between the last two pixels of the object. Upwards they
    do not, because its height is known from its upper side and the table.

    Args:
        points: Surface points of an image, world frame, metres.
        own: Pixels of the object. At the border of the image, an object has no border.
    """
    found = []
    for axis, flipped in itertools.product((1, 2), (False, True)):
        place, mine = (np.moveaxis(value, axis, 0) for value in (points, own))
        if flipped:
            place, mine = place[::-1], mine[::-1]
        last = mine[:-2] & mine[1:-1] & ~mine[2:]
        step = (place[1:-1] - place[:-2])[last] * (1, 1, 0)
        length = np.linalg.norm(step, axis=-1, keepdims=True)
        step *= LONGEST_STEP / np.maximum(length, LONGEST_STEP)
        found.append(place[1:-1][last] + step / 2)
    return np.concatenate(found)


def fused_points(seen: Sequence[Points], motions: dict[int, Motion], *, table: float) -> Points:
    """Points of an object in a group of frames, as in the first of them.

    Those of an object that stands on the table and does not turn over are repeated there, at its feet.
    """
    points = np.concatenate([(seen[frame] - motion.shift) @ motion.rotation for frame, motion in motions.items()])
    # Direction and height of the vertical as seen from the object: z = R_3 x + t_3.
    verticals = np.array([motion.rotation[2] for motion in motions.values()])
    vertical = verticals.mean(axis=0) / np.linalg.norm(verticals.mean(axis=0))
    lowest = median(np.array([seen[frame][:, 2].min() for frame in motions]))
    if (verticals @ vertical).min() < STEADY or lowest > table + STANDING:
        return points
    height = points @ vertical + median(np.array([motion.shift[2] for motion in motions.values()])) - table
    return np.concatenate([points, points - height[:, None] * vertical])


def nearest_axes(rotation: Float[Tensor, "3 3"], before: Float[Tensor, "3 3"]) -> Float[Tensor, "3 3"]:
    """Choose among the 24 rotations of the same box the one nearest to the rotation before."""
    named = equivalents(rotation)
    return named[(before * named).sum(dim=(-1, -2)).argmax()]


def _step(source: Points, target: Points, normals: Points) -> Motion:
    """Small motion that brings points nearer to their counterparts, mostly along the normals."""
    middle = source.mean(axis=0)
    offset = target - source
    # Weighted rows of the linear equations in the rotation vector and the shift.
    weights = 1 / np.sqrt(1 + (_along(offset, normals) / SCALE) ** 2)
    directions = [
        weights[:, None] * normals,
        *(np.sqrt(SLIDING) * np.broadcast_to(axis, source.shape) for axis in np.eye(3)),
    ]
    rows = np.concatenate([np.hstack([np.cross(source - middle, each), each]) for each in directions])
    values = np.concatenate([_along(offset, each) for each in directions])
    found = np.linalg.lstsq(rows, values, rcond=None)[0]
    rotation = Rotation.from_rotvec(found[:3]).as_matrix()
    return Motion(rotation, middle - rotation @ middle + found[3:])


def _normals(points: Points) -> Points:
    """Directions of least extent of the nearest points."""
    neighbours = points[KDTree(points).query(points, k=NEIGHBOURS)[1]]
    neighbours = neighbours - neighbours.mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", neighbours, neighbours))[1][:, :, 0]


def _along(offsets: Points, directions: Points) -> Float[np.ndarray, "_"]:
    return (offsets * directions).sum(axis=1)


def _union(surfaces: list[Surface]) -> Surface:
    return Surface(joined([each.cloud for each in surfaces]), np.concatenate([each.normals for each in surfaces]))
