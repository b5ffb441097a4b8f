"""Tests of whether parts of a clip move as one rigid body: otherwise they fit worse together than each on its own.

Moving alike proves little, as a stack slides as a whole. Turning over together does.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64
from scipy.spatial import KDTree

from obpose.contact.motion.tracking import Cloud, Points, joined, kabsch, outlier_limit

STEPS = (1, 3)
"""Frames between which motion is measured."""
LEAST_POINTS = 8
"""Parts with fewer points in a frame are not registered."""
NEAR = 0.04
"""Distance in metres up to which parts are compared in two frames; one frame suffices."""
ROUNDS, JOINT_ROUNDS = 6, 4
"""Rounds of registration of a part, and of two parts from the motion of either."""
FARTHEST = 0.05
"""Upper limit of residuals in metres, so that single points do not decide."""
LARGEST = 3
"""Number of comparisons, those with the largest excess, that are averaged."""
TOGETHER = 0.0015
"""Largest excess residual in metres of parts that move together."""
TUMBLING = np.cos(np.radians(10))
"""Largest cosine of the vertical's rotation by which parts that move together turn over."""
EXPLAINED = 0.002
"""Metres by which the common motion must reduce the residuals of parts that turn over together."""


class Motion(NamedTuple):
    """Rigid motion."""

    rotation: Float[np.ndarray, "3 3"]
    shift: Float[np.ndarray, "3"]

    def moved(self, cloud: Cloud) -> Cloud:
        """Move a cloud."""
        return Cloud(cloud.points @ self.rotation.T + self.shift, cloud.colours)

    def then(self, other: "Motion") -> "Motion":
        """Compose with a motion that follows."""
        return Motion(other.rotation @ self.rotation, other.rotation @ self.shift + other.shift)

    @property
    def inverse(self) -> "Motion":
        """The motion back."""
        return Motion(self.rotation.T, -self.rotation.T @ self.shift)


REST = Motion(np.eye(3), np.zeros(3))


class CommonMotion(NamedTuple):
    """Evidence of motion on whether pairs of parts belong together; both arrays are symmetric."""

    excess: Float[np.ndarray, "part part"]
    """Mean residual in metres of joint registration minus that of separate ones, averaged over the frames where the
    two differ most; 0 for pairs that were not near each other in frames where both are visible."""
    tumbling: Bool[np.ndarray, "part part"]
    """Whether the two turn over together between two of the frames."""


def common_motion(clouds: Sequence[Cloud], labels: Sequence[Int64[np.ndarray, "_"]], *, views: int = 1) -> CommonMotion:
    """Measure how much worse pairs of parts fit if they are registered together than each on its own.

    Args:
        clouds: Foreground of each image, in the order of time; those of one time, one per view, follow each other.
        labels: Part of each point, from 0.
        views: Number of views.
    """
    count = 1 + max((int(found.max()) for found in labels if len(found)), default=-1)
    parts = [
        {name: cloud.part(found == name) for name in _large(found)} for cloud, found in zip(clouds, labels, strict=True)
    ]
    excesses: dict[tuple[int, int], list[float]] = {}
    tumbling = np.zeros((count, count), bool)
    # Compare frames at several distances in time.
    for step in STEPS:
        for before, after in zip(parts, parts[step * views :], strict=False):
            for pair, excess, tumbled in _compare(before, after):
                excesses.setdefault(pair, []).append(excess)
                tumbling[pair] |= tumbled
    # One separate motion is enough: the largest values count.
    found = np.zeros((count, count))
    for pair, values in excesses.items():
        found[pair] = np.mean(np.sort(values)[-LARGEST:])
    return CommonMotion(found + found.T, tumbling | tumbling.T)


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


def _compare(before: dict[int, Cloud], after: dict[int, Cloud]) -> Iterator[tuple[tuple[int, int], float, bool]]:
    """Excess residuals of the pairs of parts that are near each other in one of two frames, and whether they tumble."""
    motions = {
        name: register(before[name], after[name], None, rounds=ROUNDS) for name in sorted(before.keys() & after.keys())
    }
    for one, other in combinations(motions, 2):
        if min(_distance(parts[one].points, parts[other].points) for parts in (before, after)) > NEAR:
            continue
        sources, targets = ([parts[one], parts[other]] for parts in (before, after))
        alone = [_residual(*each) for each in zip(sources, targets, (motions[one], motions[other]), strict=True)]
        # The better of two joint registrations.
        excess, motion, joint = np.inf, REST, alone
        for start in (motions[one], motions[other]):
            tried = register(joined(sources), joined(targets), start, rounds=JOINT_ROUNDS)
            residuals = [_residual(source, target, tried) for source, target in zip(sources, targets, strict=True)]
            if (worse := float(max(np.subtract(residuals, alone)))) < excess:
                excess, motion, joint = worse, tried, residuals
        tumbled = excess < TOGETHER and motion.rotation[2, 2] < TUMBLING
        if tumbled:
            resting = [_residual(source, target, REST) for source, target in zip(sources, targets, strict=True)]
            tumbled = min(np.subtract(resting, joint)) > EXPLAINED
        yield (one, other), excess, bool(tumbled)


def _large(labels: Int64[np.ndarray, "_"]) -> list[int]:
    """Parts with enough points."""
    return np.flatnonzero(np.bincount(labels) >= LEAST_POINTS).tolist()


def _visible(distances: Float[np.ndarray, "point"]) -> np.ndarray:
    return distances <= outlier_limit(distances)


def _residual(source: Cloud, target: Cloud, motion: Motion) -> float:
    """Mean distance of the moved points from the target, by position and colour, metres."""
    distances = KDTree(target.features).query(motion.moved(source).features)[0]
    return float(np.minimum(distances, FARTHEST).mean())


def _distance(one: Points, other: Points) -> float:
    """Distance in metres of the two nearest points."""
    return float(KDTree(one).query(other)[0].min())
