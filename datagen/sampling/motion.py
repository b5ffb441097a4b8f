"""Draw each object's intended motion, and the velocities and pushes that cause it."""

import dataclasses
from collections.abc import Sequence
from typing import get_args

import numpy as np
from jaxtyping import Float

from datagen.config import Layout, MotionConfig, Physics
from datagen.sampling import poses
from datagen.sampling.items import Item
from datagen.sampling.layout import Spot
from datagen.scene import Motion, Push, Vector, rounded, vector

KINDS: tuple[Motion, ...] = get_args(Motion)


@dataclasses.dataclass(frozen=True)
class Start:
    """An object's velocities (world frame, m/s and rad/s) and push."""

    linear_velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)
    push: Push | None = None


def sample_motion(item: Item, motion: MotionConfig, rng: np.random.Generator) -> Motion:
    """Draw a motion by the recipe's weights. Only round objects roll; others slide if no other motion has weight."""
    weights = dataclasses.asdict(motion.weights)
    if not poses.can_roll(item.shape):
        weights["roll"] = 0.0
        weights["slide"] = weights["slide"] if any(weights.values()) else 1.0
    chances = np.array([weights[kind] for kind in KINDS])
    return KINDS[rng.choice(len(KINDS), p=chances / np.sum(chances))]


def sample_starts(
    spots: Sequence[Spot], layout: Layout, motion: MotionConfig, physics: Physics, rng: np.random.Generator
) -> list[Start]:
    """Draw velocities and pushes; the objects of a group share theirs."""
    if not motion.moving:
        return [Start() for _ in spots]
    grouped = [row for row, spot in enumerate(spots) if spot.in_group]
    starts = {row: _start(row, spots, layout, motion, physics, rng) for row in range(len(spots)) if row not in grouped}
    if grouped:
        starts |= _group_starts(grouped, spots, layout, motion, physics, rng)
    return [starts[row] for row in range(len(spots))]


def _start(
    row: int,
    spots: Sequence[Spot],
    layout: Layout,
    motion: MotionConfig,
    physics: Physics,
    rng: np.random.Generator,
) -> Start:
    spot = spots[row]
    heading = _heading(row, spots, layout, motion, rng)
    speed = rng.uniform(*motion.speed)
    tumble = motion.spin * rng.uniform(-1, 1, 3)
    if spot.motion == "slide":
        return Start(vector([*(speed * heading), 0.0]), vector([0.0, 0.0, 0.3 * tumble[2]]))
    if spot.motion == "roll":
        return _roll(spot, speed, heading)
    if spot.motion == "push":
        start, duration = rng.uniform(*motion.push_start), rng.uniform(*motion.push_duration)
        return Start(push=_push(spot.item, speed, heading, start, duration, physics))
    if spot.motion == "throw":
        return Start(vector([*(speed * heading), rng.uniform(-0.3, 0.6)]), vector(tumble))
    return Start(angular_velocity=vector(0.5 * tumble)) if spot.motion == "drop" else Start()


def _roll(spot: Spot, speed: float, heading: Float[np.ndarray, "2"]) -> Start:
    """Rolling without slipping; what has an axis rolls across it, to the side that is nearer to the heading."""
    if spot.item.shape.symmetry != "SO3":
        axis = spot.stance.rotation[:2, 2]
        across = np.array([-axis[1], axis[0]])
        heading = across * (1.0 if across @ heading >= 0 else -1.0)
    rate = speed / -spot.stance.bottom
    return Start(vector([*(speed * heading), 0.0]), vector([-rate * heading[1], rate * heading[0], 0.0]))


def _push(
    item: Item, speed: float, heading: Float[np.ndarray, "2"], start: float, duration: float, physics: Physics
) -> Push:
    """A horizontal force that overcomes friction and reaches the speed by its end."""
    friction = item.friction * physics.table_friction * physics.gravity
    force = item.density * item.shape.volume * (friction + speed / duration) * heading
    return Push(rounded(start), rounded(duration), vector([*force, 0.0]))


def _group_starts(
    grouped: Sequence[int],
    spots: Sequence[Spot],
    layout: Layout,
    motion: MotionConfig,
    physics: Physics,
    rng: np.random.Generator,
) -> dict[int, Start]:
    """One velocity, or pushes in proportion to mass: with equal friction either moves the group as one body."""
    heading = _heading(0, [spots[grouped[0]]], layout, motion, rng)
    speed = rng.uniform(*motion.speed)
    if spots[grouped[0]].motion == "slide":
        return dict.fromkeys(grouped, Start(vector([*(speed * heading), 0.0])))
    start, duration = rng.uniform(*motion.push_start), rng.uniform(*motion.push_duration)
    return {row: Start(push=_push(spots[row].item, speed, heading, start, duration, physics)) for row in grouped}


def _heading(
    row: int, spots: Sequence[Spot], layout: Layout, motion: MotionConfig, rng: np.random.Generator
) -> Float[np.ndarray, "2"]:
    """Unit vector on the table towards another object, or towards some place of the region."""
    targets = [spot.position[:2] for other, spot in enumerate(spots) if other != row]
    if targets and rng.uniform() < motion.aim_share:
        target = targets[rng.integers(len(targets))] + 0.015 * rng.normal(size=2)
    else:
        target = np.array(layout.center) + np.array(layout.half_extent) * rng.uniform(-1, 1, 2)
    way = target - spots[row].position[:2]
    return way / max(np.sqrt(np.sum(way**2)), 1e-9)
