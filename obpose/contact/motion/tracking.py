"""Objects followed through a clip by assignment of points and rigid registration, in turns.

Registration alternates with assignment as in iterative closest points (Besl and McKay 1992).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

LEAST_POINTS = 6
"""Components of fewer points are not objects."""
COLOUR_SCALE = 0.15
"""Metres that the step from black to full red, green or blue counts as, where points are assigned to objects."""
NEW_OBJECT = 0.05
"""Distance in metres from all objects beyond which points start a new one."""
ROUNDS = 6
"""Rounds of assignment and registration in each frame."""
TRANSLATIONS = 2
"""Initial rounds that only translate: rotations from a wrong assignment do not recover."""
LEAST_FOR_ROTATION = 12
"""Number of points from which a rotation is estimated."""
LARGEST_ANGLE = 0.6
"""Largest rotation in one round, radians; larger ones come from wrong correspondences."""
OUTLIER_FACTOR, LEAST_OUTLIER = 2.5, 0.01
"""Points of an object are hidden if they are farther from what is seen than this factor times the median distance, and
than this many metres."""
NEIGHBOURS = 6
"""Nearest points, the point itself included, over which labels are smoothed."""

Points = Float[np.ndarray, "_ 3"]
Pairs = tuple[Float[np.ndarray, "pair 3"], Float[np.ndarray, "pair 3"]]
"""Points and their counterparts."""


class Cloud(NamedTuple):
    """Points above the table of one image, or of all views of a frame."""

    points: Points
    """Positions in metres, in one frame of reference for the clip; `rigidity` and `boxes` expect z upwards."""
    colours: Points
    """RGB in 0..1, times `COLOUR_SCALE`."""

    @property
    def features(self) -> Float[np.ndarray, "point 6"]:
        """Position and scaled colour."""
        return np.hstack([self.points, self.colours])

    def part(self, chosen: np.ndarray) -> "Cloud":
        """Select some of the points."""
        return Cloud(self.points[chosen], self.colours[chosen])


class Followed(NamedTuple):
    """An object as it was last seen, or as it is predicted for the next frame."""

    cloud: Cloud
    velocity: Float[np.ndarray, "3"]
    """Metres per frame."""


def track(
    clouds: Sequence[Cloud], key: int, labels: Int64[np.ndarray, "point"], gap: float
) -> list[Int64[np.ndarray, "_"]]:
    """Follow the objects of a key frame forwards and backwards.

    Args:
        clouds: Foreground of each frame.
        key: Index of the key frame.
        labels: Objects of its points, from 0.
        gap: Largest distance in metres of neighbouring points of a new object.

    Returns:
        Labels of all frames, from 0, with one label for an object over time.
    """
    found = [np.zeros(len(cloud.points), np.int64) for cloud in clouds]
    found[key] = labels
    unused = int(labels.max(initial=-1)) + 1
    for order in (range(key + 1, len(clouds)), range(key - 1, -1, -1)):
        objects = {int(name): Followed(clouds[key].part(labels == name), np.zeros(3)) for name in np.unique(labels)}
        for frame in order:
            found[frame], objects, unused = follow(clouds[frame], objects, gap, unused)
    return found


def follow(
    cloud: Cloud, objects: dict[int, Followed], gap: float, unused: int
) -> tuple[Int64[np.ndarray, "point"], dict[int, Followed], int]:
    """Label the points of the next frame; also give the objects as they are there, and the next unused label."""
    if not len(cloud.points):
        return np.zeros(0, np.int64), {name: _unseen(seen) for name, seen in objects.items()}, unused
    labels, distances, predicted = register(cloud, objects)

    # Points far from all objects start new ones.
    far = np.flatnonzero(distances > NEW_OBJECT)
    components = split(cloud.points[far], gap)
    for component in large(components):
        labels[far[components == component]] = unused
        unused += 1

    # Objects with too few visible points keep their predicted points.
    after = {}
    for name in {*objects, *labels.tolist()}:
        seen = labels == name
        if np.count_nonzero(seen) >= LEAST_POINTS:
            moved = predicted[name] - objects[name].cloud.points if name in objects else np.zeros((1, 3))
            after[name] = Followed(cloud.part(seen), moved.mean(axis=0))
        elif name in objects:
            after[name] = Followed(Cloud(predicted[name], objects[name].cloud.colours), np.zeros(3))
    return labels, after, unused


def register(
    cloud: Cloud, objects: dict[int, Followed]
) -> tuple[Int64[np.ndarray, "point"], Float[np.ndarray, "point"], dict[int, Points]]:
    """Assign points to objects and move the objects to them, in turns.

    Returns:
        The object of each point, its distance from the nearest object (position and scaled colour, metres), and the
        moved points of the objects.
    """
    features, distances, nearest = cloud.features, np.full(len(cloud.points), np.inf), np.zeros(0, np.int64)
    if not objects:
        return np.full(len(cloud.points), -1), distances, {}
    names = np.array([*objects])
    predicted = {name: seen.cloud.points + seen.velocity for name, seen in objects.items()}
    sizes = [len(seen.cloud.points) for seen in objects.values()]
    owner, start = np.repeat(np.arange(len(names)), sizes), np.cumsum([0, *sizes])
    for turn in range(ROUNDS):
        models = [np.hstack([predicted[name], objects[name].cloud.colours]) for name in objects]
        # One tree of all objects: the nearest point belongs to the nearest object.
        distances, places = map(np.asarray, KDTree(np.concatenate(models)).query(features))
        nearest = owner[places]
        # Move each object to its points; turn it only after it has been shifted into place.
        for number, name in enumerate(objects):
            mine = nearest == number
            if np.count_nonzero(mine) >= 3:
                model = Cloud(predicted[name], objects[name].cloud.colours)
                pairs = correspondences(model, cloud.part(mine), places[mine] - start[number])
                predicted[name] = move(predicted[name], pairs, turning=turn >= TRANSLATIONS)
    return names[smooth(features, nearest)], distances, predicted


def correspondences(model: Cloud, seen: Cloud, nearest: Int64[np.ndarray, "seen"]) -> Pairs:
    """Pairs of points of an object and of what is seen of it, in both directions, without its hidden points."""
    distances, back = KDTree(seen.features).query(model.features)
    visible = distances < outlier_limit(distances)
    return (
        np.concatenate([model.points[nearest], model.points[visible]]),
        np.concatenate([seen.points, seen.points[np.asarray(back)[visible]]]),
    )


def outlier_limit(distances: Float[np.ndarray, "_"]) -> float:
    """Distance of corresponding points, by position and colour, above which one of them is hidden."""
    return max(OUTLIER_FACTOR * median(distances), LEAST_OUTLIER)


def joined(clouds: Sequence[Cloud]) -> Cloud:
    """All points of several clouds."""
    return Cloud(np.concatenate([each.points for each in clouds]), np.concatenate([each.colours for each in clouds]))


def median(values: Float[np.ndarray, "_"]) -> float:
    """Median; ten times as fast as `numpy.median` for some dozen values."""
    ordered, middle = np.sort(values), len(values) // 2
    return float(ordered[middle] if len(values) % 2 else (ordered[middle - 1] + ordered[middle]) / 2)


def move(points: Points, pairs: Pairs, *, turning: bool) -> Points:
    """Move points by the rigid motion that best maps the first of each pair to the second, or by its translation."""
    source, target = pairs
    shift = (target - source).mean(axis=0)
    if not turning or len(points) < LEAST_FOR_ROTATION:
        return points + shift
    rotation = kabsch(source, target)
    if np.trace(rotation) < 1 + 2 * np.cos(LARGEST_ANGLE):
        return points + shift
    return (points - source.mean(axis=0)) @ rotation.T + target.mean(axis=0)


def kabsch(source: Points, target: Points) -> Float[np.ndarray, "3 3"]:
    """Rotation that best maps the centred source to the centred target (Kabsch 1976)."""
    u, _, vt = np.linalg.svd((source - source.mean(axis=0)).T @ (target - target.mean(axis=0)))
    return vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T


def smooth(features: Float[np.ndarray, "point 6"], labels: Int64[np.ndarray, "point"]) -> Int64[np.ndarray, "point"]:
    """Replace labels by those that prevail among the nearest points; the smaller label where two are level.

    The point itself has half a vote, its neighbours share half a vote, and their neighbours share one.
    """
    nearest = KDTree(features).query(features, k=min(NEIGHBOURS, len(features)))[1]
    neighbours = np.reshape(nearest, (len(features), -1))
    count = neighbours.shape[1]
    # Votes of each point, sorted by label.
    first = labels[neighbours]
    cast = np.hstack([labels[:, None], first, first[neighbours].reshape(len(labels), -1)])
    weights = np.repeat([count**2, count, 2], [1, count, count**2])
    order = np.argsort(cast, axis=1)
    cast = np.take_along_axis(cast, order, axis=1)
    # Sum of the votes for each label, at the last of them.
    total = np.cumsum(weights[order], axis=1)
    last = np.ones(cast.shape, bool)
    last[:, :-1] = cast[:, 1:] != cast[:, :-1]
    before = np.zeros_like(total)
    before[:, 1:] = np.maximum.accumulate(np.where(last, total, 0), axis=1)[:, :-1]
    winner = np.where(last, total - before, 0).argmax(axis=1)
    return np.take_along_axis(cast, winner[:, None], axis=1)[:, 0]


def split(points: Points, gap: float) -> Int64[np.ndarray, "point"]:
    """Connected components, from 0, of points that are connected if at most `gap` metres apart."""
    if not len(points):
        return np.zeros(0, np.int64)
    pairs = KDTree(points).query_pairs(gap, output_type="ndarray").T
    graph = coo_array((np.ones(pairs.shape[1], np.int8), (pairs[0], pairs[1])), (len(points), len(points)))
    return connected_components(graph, directed=False)[1].astype(np.int64)


def large(labels: Int64[np.ndarray, "point"]) -> Int64[np.ndarray, "component"]:
    """Components with at least `LEAST_POINTS` points."""
    return np.flatnonzero(np.bincount(labels) >= LEAST_POINTS)


def join_small(points: Points, labels: Int64[np.ndarray, "point"]) -> Int64[np.ndarray, "point"]:
    """Give the points of small components to the large component that is nearest, if there is one."""
    inside = np.isin(labels, large(labels))
    if inside.all() or not inside.any():
        return labels
    joined = labels.copy()
    joined[~inside] = labels[inside][KDTree(points[inside]).query(points[~inside])[1]]
    return joined


def _unseen(seen: Followed) -> Followed:
    return Followed(Cloud(seen.cloud.points + seen.velocity, seen.cloud.colours), np.zeros(3))
