"""Average linkage of signed pairs (Bailoni et al. 2022)."""

import heapq

import numpy as np
from jaxtyping import Float, Int64


def average_linkage(
    count: int,
    pairs: Int64[np.ndarray, "2 edge"],
    attractions: Float[np.ndarray, "edge"],
    weights: Float[np.ndarray, "edge"] | None = None,
) -> Int64[np.ndarray, "node"]:
    """Join the two segments with the largest mean attraction between them, until no mean is positive.

    Args:
        count: Number of nodes.
        pairs: The two nodes of each edge.
        attractions: Attraction along each edge.
        weights: Weight of each edge in means; 1 if not given.

    Returns:
        The segment of every node, numbered from 0.
    """
    shares = np.ones(len(attractions)) if weights is None else weights
    # Weighted sum and weight of the edges between each pair of segments.
    between: list[dict[int, tuple[float, float]]] = [{} for _ in range(count)]
    for one, other, attraction, weight in zip(*pairs.tolist(), attractions.tolist(), shares.tolist(), strict=True):
        total, number = between[one].get(other, (0.0, 0.0))
        between[one][other] = between[other][one] = (total + weight * attraction, number + weight)
    queue = [(-total / number, i, j) for i, row in enumerate(between) for j, (total, number) in row.items() if i < j]
    heapq.heapify(queue)
    parent = list(range(count))
    while queue and queue[0][0] < 0:
        mean, one, other = heapq.heappop(queue)
        edge = between[one].get(other)
        if edge is None or -edge[0] / edge[1] != mean:
            continue  # joined or changed since
        if len(between[one]) < len(between[other]):
            one, other = other, one
        parent[other] = one
        del between[one][other], between[other][one]
        for third, (total, number) in between[other].items():
            del between[third][other]
            before = between[one].get(third, (0.0, 0.0))
            joined = (before[0] + total, before[1] + number)
            between[one][third] = between[third][one] = joined
            heapq.heappush(queue, (-joined[0] / joined[1], min(one, third), max(one, third)))
        between[other] = {}
    roots = np.array([_root(parent, node) for node in range(count)], np.int64)
    return np.unique(roots, return_inverse=True)[1]


def _root(parent: list[int], node: int) -> int:
    while parent[node] != node:
        node = parent[node]
    return node
