"""Pairs of neighbouring pixels, and connected components of what stands above the table.

Components are the pseudo-objects for training without labels. The network predicts affinities of the pairs.
"""

import numpy as np
from jaxtyping import Bool, Float, Int64, Integer
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows and columns from a pixel to half of its eight neighbours."""
FLOATING = 0.03
"""Height in metres of its lowest point above the table from which a component floats."""
BELOW = 0.015
"""Largest horizontal distance in metres between a floating component and what supports it."""
_STEPS = (1, 3, 7)
OFFSETS = len(NEIGHBOURS) * len(_STEPS)
"""Number of partners of each pixel."""


def offsets(scale: int) -> list[tuple[int, int]]:
    """Rows and columns from a pixel to its partners, for a network trained on images with `scale` times 64 columns.

    Longer steps grow with the training images. Direct neighbours remain partners, so that all pixels are connected.
    """
    steps = [step if step == 1 else step * scale for step in _STEPS]
    return [(down * step, right * step) for step in steps for down, right in NEIGHBOURS]


def image_components(
    points: Float[np.ndarray, "height width 3"],
    standing: Bool[np.ndarray, "height width"],
    *,
    gap: float,
    least: int,
) -> Int64[np.ndarray, "height width"]:
    """Label the connected components of an image.

    Args:
        points: Surface points in metres.
        standing: Pixels that belong to components.
        gap: Largest distance in metres between the points of connected neighbours.
        least: Components with fewer pixels are left out.

    Returns:
        Components from 1 in the order of their first pixels, 0 elsewhere.
    """
    labels = np.zeros(standing.shape, np.int64)
    count = int(np.count_nonzero(standing))
    if not count:
        return labels
    index = np.full(standing.shape, -1)
    index[standing] = np.arange(count)
    pairs = np.hstack([_connected(points, index, offset, gap) for offset in NEIGHBOURS])
    found = _united(pairs, count)
    sizes = np.bincount(found)
    names = np.where(sizes >= least, np.cumsum(sizes >= least), 0)
    labels[standing] = names[found]
    return labels


def join_floating(
    labels: Int64[np.ndarray, "height width"], points: Float[np.ndarray, "height width 3"], *, table: float
) -> Int64[np.ndarray, "height width"]:
    """Join components that float above the table with those below them, as nothing floats in a scene at rest.

    A thin part between the two, such as the stem of a lamp, may be too narrow to be seen.

    Args:
        labels: Components, 0 elsewhere.
        points: Surface points in metres, world frame.
        table: Height of the table, metres.

    Returns:
        Components from 1 in the order of their first pixels, 0 elsewhere.
    """
    seen = labels > 0
    place, name = points[seen], labels[seen]
    pairs = [np.zeros((2, 0), np.int64)]
    for component in np.unique(name):
        own = name == component
        lowest = place[own, 2].min()
        if lowest < table + FLOATING:
            continue
        below = place[:, 2] < lowest
        distance = KDTree(place[own, :2]).query(place[below, :2], distance_upper_bound=BELOW)[0]
        others = np.unique(name[below][np.isfinite(distance)])
        pairs.append(np.stack([np.full(len(others), component), others]))
    joined = _united(np.hstack(pairs), int(labels.max()) + 1)[labels]
    return numbered(np.where(seen, joined + 1, 0))


def _connected(
    points: Float[np.ndarray, "height width 3"], index: Int64[np.ndarray, "height width"], offset: tuple, gap: float
) -> Int64[np.ndarray, "2 pair"]:
    """Pairs of indices of connected pixels that are `offset` apart."""
    here, there = shifted(index.shape, offset)
    distance = np.linalg.norm(points[there] - points[here], axis=-1)
    linked = (index[here] >= 0) & (index[there] >= 0) & (distance < gap)
    return np.stack([index[here][linked], index[there][linked]])


def _united(pairs: Int64[np.ndarray, "2 pair"], count: int) -> Integer[np.ndarray, "node"]:
    """Component of each of `count` nodes that pairs connect."""
    graph = coo_array((np.ones(pairs.shape[1], np.int8), (pairs[0], pairs[1])), (count, count))
    return connected_components(graph, directed=False)[1]


def numbered(labels: Integer[np.ndarray, "height width"]) -> Int64[np.ndarray, "height width"]:
    """Number the labels of an image from 1 in the order of their first pixels; 0 stays."""
    names, first, index = np.unique(labels, return_index=True, return_inverse=True)
    numbers = np.zeros(len(names), np.int64)
    order = np.argsort(first)
    order = order[names[order] != 0]
    numbers[order] = np.arange(1, len(order) + 1)
    return numbers[index].reshape(labels.shape)


def shifted(shape: tuple[int, ...], offset: tuple[int, int]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Slices of the pixels of an image that have a partner at an offset (rows, columns), and of their partners."""
    (down, right), (height, width) = offset, shape
    here = slice(max(0, -down), max(0, height - max(0, down))), slice(max(0, -right), max(0, width - max(0, right)))
    there = slice(max(0, down), max(0, height + min(0, down))), slice(max(0, right), max(0, width + min(0, right)))
    return here, there
