"""Do parts of a clip move as one rigid body? Registered together, they fit worse than each on its own if not."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int64
from scipy.spatial import KDTree

from obpose.contact.tracking import LEAST_OUTLIER, OUTLIER_FACTOR, Cloud, Points, kabsch, median

STEPS = (1, 3)
"""Frames between which motion is measured."""
LEAST_POINTS = 8
"""Parts with fewer points in a frame are not registered."""
NEAR = 0.04
"""Parts are compared in two frames if they are at most so many metres apart in one of them."""
ROUNDS, JOINT_ROUNDS = 6, 4
"""Rounds of registration of a part, and of two parts from the motion of either."""
FARTHEST = 0.05
"""Residuals are at most so many metres, so that single points do not decide."""
LARGEST = 3
"""Number of comparisons, those with the largest excess, that are averaged."""


class Motion(NamedTuple):
    """Rigid motion."""

    rotation: Float[np.ndarray, "3 3"]
    shift: Float[np.ndarray, "3"]

    def moved(self, cloud: Cloud) -> Cloud:
        """Move a cloud."""
        return Cloud(cloud.points @ self.rotation.T + self.shift, cloud.colours)


def divergences(
    clouds: Sequence[Cloud], labels: Sequence[Int64[np.ndarray, "_"]], *, views: int = 1
) -> Float[np.ndarray, "part part"]:
    """Measure how much worse pairs of parts fit if they are registered together than each on its own.

    Args:
        clouds: Foreground of each image, in the order of time; those of one time, one per view, follow each other.
        labels: Part of each point, from 0.
        views: Number of views.

    Returns:
        Mean residual in metres of joint registration minus that of separate ones, averaged over the frames where the
        two differ most; symmetric, 0 for pairs that were not near each other in frames where both are visible.
    """
    count = 1 + max((int(found.max()) for found in labels if len(found)), default=-1)
    parts = [
        {name: cloud.part(found == name) for name in _large(found)} for cloud, found in zip(clouds, labels, strict=True)
    ]
    excesses: dict[tuple[int, int], list[float]] = {}
    for step in STEPS:
        for before, after in zip(parts, parts[step * views :], strict=False):
            for pair, excess in _compare(before, after):
                excesses.setdefault(pair, []).append(excess)
    found = np.zeros((count, count))
    for (one, other), values in excesses.items():
        found[one, other] = found[other, one] = np.mean(np.sort(values)[-LARGEST:])
    return found


def register(source: Cloud, target: Cloud, motion: Motion | None, *, rounds: int) -> Motion:
    """Find the rigid motion from one cloud to another by iterative closest points (Besl and McKay 1992).

    Points are paired in both directions by position and colour; hidden points, far from the other cloud, are left out.
    The first round only translates.

    Args:
        source: Points to be moved.
        target: Points to be reached.
        motion: Initial motion; None: between the means.
        rounds: Number of rounds.
    """
    if motion is None:
        motion = Motion(np.eye(3), target.points.mean(axis=0) - source.points.mean(axis=0))
    tree = KDTree(target.features)
    for turn in range(rounds):
        moved = motion.moved(source).features
        there, nearest = tree.query(moved)
        back, origin = KDTree(moved).query(target.features)
        seen, reached = _visible(there), _visible(back)
        start = np.concatenate([source.points[seen], source.points[np.asarray(origin)[reached]]])
        end = np.concatenate([target.points[np.asarray(nearest)[seen]], target.points[reached]])
        rotation = kabsch(start, end) if turn else motion.rotation
        motion = Motion(rotation, end.mean(axis=0) - rotation @ start.mean(axis=0))
    return motion


def _compare(before: dict[int, Cloud], after: dict[int, Cloud]) -> Iterator[tuple[tuple[int, int], float]]:
    """Excess residuals of the pairs of parts that are near each other in one of two frames."""
    motions = {
        name: register(before[name], after[name], None, rounds=ROUNDS) for name in sorted(before.keys() & after.keys())
    }
    for one, other in combinations(motions, 2):
        if min(_distance(parts[one].points, parts[other].points) for parts in (before, after)) > NEAR:
            continue
        sources, targets = ([parts[one], parts[other]] for parts in (before, after))
        alone = [_residual(*each) for each in zip(sources, targets, (motions[one], motions[other]), strict=True)]
        excess = np.inf
        for start in (motions[one], motions[other]):
            motion = register(_union(sources), _union(targets), start, rounds=JOINT_ROUNDS)
            joint = [_residual(source, target, motion) for source, target in zip(sources, targets, strict=True)]
            excess = min(excess, max(np.subtract(joint, alone)))
        yield (one, other), float(excess)


def _large(labels: Int64[np.ndarray, "_"]) -> list[int]:
    """Parts with enough points."""
    return np.flatnonzero(np.bincount(labels) >= LEAST_POINTS).tolist()


def _union(clouds: list[Cloud]) -> Cloud:
    return Cloud(np.concatenate([each.points for each in clouds]), np.concatenate([each.colours for each in clouds]))


def _visible(distances: Float[np.ndarray, "point"]) -> np.ndarray:
    return distances <= max(OUTLIER_FACTOR * median(distances), LEAST_OUTLIER)


def _residual(source: Cloud, target: Cloud, motion: Motion) -> float:
    """Mean distance of the moved points from the target, by position and colour, metres."""
    distances = KDTree(target.features).query(motion.moved(source).features)[0]
    return float(np.minimum(distances, FARTHEST).mean())


def _distance(one: Points, other: Points) -> float:
    """Distance in metres of the two nearest points."""
    return float(KDTree(one).query(other)[0].min())
