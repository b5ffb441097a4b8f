"""Initial placement of objects: apart from each other, in contact, or on top of each other."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from datagen.config import Layout, MotionConfig
from datagen.sampling import poses
from datagen.sampling.items import Item, Rejected
from datagen.sampling.poses import Stance
from datagen.scene import Motion

AIRBORNE = ("drop", "throw")

_CLEARANCE = 2e-4
"""Initial gap between touching surfaces, metres, so that the simulation does not start by pushing them apart."""

_OPENING, _SPREAD, _DROP = 0.75, 0.015, (0.005, 0.02)
"""Longest diagonal of what fits into a container, in widths of the container; largest distance from its middle along
each axis, and range of the free height below, metres."""


@dataclass(frozen=True, eq=False)
class Spot:
    """An object at its place."""

    item: Item
    motion: Motion
    stance: Stance
    position: Float[np.ndarray, "3"]
    """Position of the centre of mass, metres."""
    in_group: bool = False
    """Whether the object belongs to the group that touches and moves as one."""
    touches: int | None = None
    """Row of the earlier object with which this one is brought into contact."""

    @property
    def low(self) -> float:
        """Height of the object's lowest point, metres."""
        return self.position[2] + self.stance.bottom

    @property
    def high(self) -> float:
        """Height of the object's highest point, metres."""
        return self.position[2] + self.stance.top


def fill(
    container: Item, items: Sequence[Item], layout: Layout, motion: MotionConfig, rng: np.random.Generator
) -> list[Spot]:
    """Stand a container on the table, and hang objects that fit in above it, one above the other.

    Raises:
        Rejected: as `place`.
    """
    spots = [place(container, "rest", [], dataclasses.replace(layout, upright_share=1.0), motion, rng)]
    x, y, _ = spots[0].position.tolist()
    inside = dataclasses.replace(layout, center=(x, y), half_extent=(_SPREAD, _SPREAD))
    for item in items:
        spots.append(place(item, "drop", spots, inside, dataclasses.replace(motion, drop_height=_DROP), rng))
    return spots


def fits(item: Item, container: Item) -> bool:
    """Whether an object fits into a container, whatever its orientation."""
    return float(np.sqrt(np.sum(item.shape.size**2))) < _OPENING * float(np.min(container.shape.size[:2]))


def scatter(
    items: Sequence[Item],
    motions: Sequence[Motion],
    layout: Layout,
    motion: MotionConfig,
    rng: np.random.Generator,
    others: Sequence[Spot] = (),
) -> list[Spot]:
    """Place every object apart from all others; airborne objects may hang above those on the table.

    Raises:
        Rejected: no free place was found for one of them.
    """
    spots = [*others]
    for row in sorted(range(len(items)), key=lambda row: motions[row] in AIRBORNE):
        spot = try_to_place(items[row], motions[row], spots, layout, motion, rng)
        if spot is None:
            # What is airborne comes last, and always finds a place.
            raise Rejected("crowded", fitting=len(spots) + sum(kind in AIRBORNE for kind in motions))
        spots.append(spot)
    return spots


def place(
    item: Item, kind: Motion, others: Sequence[Spot], layout: Layout, motion: MotionConfig, rng: np.random.Generator
) -> Spot:
    """Place one object on or above the table, at least `layout.gap` away from the others.

    Raises:
        Rejected: no free place was found.
    """
    spot = try_to_place(item, kind, others, layout, motion, rng)
    if spot is None:
        raise Rejected("crowded")
    return spot


def try_to_place(
    item: Item, kind: Motion, others: Sequence[Spot], layout: Layout, motion: MotionConfig, rng: np.random.Generator
) -> Spot | None:
    """Place one object like `place`, or return None if no free place was found; airborne objects always find one."""
    stance = sample_stance(item, kind, layout, rng)
    height = rng.uniform(*motion.drop_height) if kind in AIRBORNE else _CLEARANCE
    centers, reaches = _discs(others)
    for _ in range(layout.tries):
        center = np.array(layout.center) + np.array(layout.half_extent) * rng.uniform(-1, 1, 2)
        below = np.flatnonzero(_overlaps_from_above(center, stance.reach, centers, reaches, layout.gap))
        if len(below) and kind not in AIRBORNE:
            continue
        ground = max((others[row].high for row in below.tolist()), default=0.0)
        return Spot(item, kind, stance, np.array([*center, ground + height - stance.bottom]))
    return None


def _discs(spots: Sequence[Spot]) -> tuple[Float[np.ndarray, "spot 2"], Float[np.ndarray, "spot"]]:
    """Centres and radii of the discs that objects cover, seen from above."""
    centers = np.array([spot.position[:2] for spot in spots], float).reshape(-1, 2)
    return centers, np.array([spot.stance.reach for spot in spots], float)


def _overlaps_from_above(
    center: Float[np.ndarray, "2"],
    reach: float,
    centers: Float[np.ndarray, "spot 2"],
    reaches: Float[np.ndarray, "spot"],
    gap: float,
) -> Bool[np.ndarray, "spot"]:
    """Whether a disc comes nearer than `gap` metres to each of the others."""
    distance = np.sqrt(np.sum((center - centers) ** 2, axis=1))
    return distance < reach + reaches + gap


def sample_stance(item: Item, kind: Motion, layout: Layout, rng: np.random.Generator) -> Stance:
    """Draw an orientation that suits the motion, turned about the vertical by a random angle."""
    yaw = rng.uniform(0, 2 * np.pi)
    if kind in AIRBORNE:
        return poses.tumbled(item.shape, rng)
    if kind == "roll":
        return poses.rolling_stance(item.shape).turned(yaw)
    stances = poses.steady_stances(item.shape)
    if not stances or rng.uniform() < layout.upright_share:
        return poses.upright(item.shape).turned(yaw)
    return stances[rng.integers(len(stances))].turned(yaw)


def flattest(item: Item) -> Stance | None:
    """Steady orientation with the lowest centre of mass; None if no orientation is steady."""
    return max(poses.steady_stances(item.shape), key=lambda stance: stance.bottom, default=None)


def cluster(items: Sequence[Item], kind: Motion, layout: Layout, rng: np.random.Generator) -> list[Spot]:
    """Place a group that moves as one: each further object lies on top of another one or touches its side.

    Raises:
        Rejected: one of them cannot lie steadily.
    """
    spots: list[Spot] = []
    for item in items:
        stance = flattest(item)
        if stance is None:
            raise Rejected("unsteady")
        stance = stance.turned(rng.uniform(0, 2 * np.pi))
        spot = _first(item, kind, stance, layout, rng) if not spots else None
        if spots and rng.uniform() < layout.stack_share:
            spot = on_top(item, kind, stance, spots, rng)
        spots.append(spot or _beside(item, kind, stance, spots, layout, rng))
    return [dataclasses.replace(spot, in_group=True) for spot in spots]


def _first(item: Item, kind: Motion, stance: Stance, layout: Layout, rng: np.random.Generator) -> Spot:
    center = np.array(layout.center) + 0.6 * np.array(layout.half_extent) * rng.uniform(-1, 1, 2)
    return Spot(item, kind, stance, np.array([*center, _CLEARANCE - stance.bottom]))


def _beside(
    item: Item, kind: Motion, stance: Stance, spots: Sequence[Spot], layout: Layout, rng: np.random.Generator
) -> Spot:
    """Place an object almost touching another one that stands on the table, clear of the rest.

    Raises:
        Rejected: no free place was found.
    """
    standing = [row for row, spot in enumerate(spots) if spot.low < 2 * _CLEARANCE]
    centers, reaches = _discs(spots)
    for _ in range(layout.tries):
        row = int(rng.choice(standing))
        angle = rng.uniform(0, 2 * np.pi)
        way = np.array([np.cos(angle), np.sin(angle)])
        distance = poses.extent(spots[row].stance, way) + poses.extent(stance, -way) + _CLEARANCE
        center = spots[row].position[:2] + distance * way
        overlaps = _overlaps_from_above(center, stance.reach, centers, reaches, 0.0)
        if not np.any(np.delete(overlaps, row)):
            return Spot(item, kind, stance, np.array([*center, _CLEARANCE - stance.bottom]), touches=row)
    raise Rejected("crowded")


def on_top(item: Item, kind: Motion, stance: Stance, spots: Sequence[Spot], rng: np.random.Generator) -> Spot | None:
    """Place an object on another one whose top carries it steadily; None if there is no such object.

    Only objects carry that are at least as high as the lower side of all others, wherever those are.
    """
    for row in rng.permutation(len(spots)):
        roof = spots[row].stance.roof
        low, high = np.min(roof, axis=0), np.max(roof, axis=0)
        offset = (low + high) / 2 + 0.25 * (high - low) * rng.uniform(-1, 1, 2)
        carried = any(spot.low > spots[row].high - 1e-3 for spot in spots)
        if carried or spots[row].motion in AIRBORNE or poses.depth_inside(roof, offset) < poses.STEADY:
            continue
        center = spots[row].position[:2] + offset
        return Spot(item, kind, stance, np.array([*center, spots[row].high + _CLEARANCE - stance.bottom]))
    return None
