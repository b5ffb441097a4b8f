"""Grouping of an image's foreground pixels into objects, from affinities and embeddings."""

import numpy as np
from jaxtyping import Bool, Float, Int64, Integer
from scipy.spatial import KDTree

from obpose.contact.components import shifted
from obpose.contact.linkage import average_linkage
from obpose.contact.offsets import offsets

LEAST = 3
"""Segments of fewer pixels join the nearest larger one."""


def group(
    mask: Bool[np.ndarray, "height width"],
    affinities: Float[np.ndarray, "offset height width"],
    embedding: Float[np.ndarray, "channel height width"],
    *,
    bias: float,
    scale: int = 1,
    components: Integer[np.ndarray, "height width"] | None = None,
) -> Int64[np.ndarray, "height width"]:
    """Label objects from 1 by average linkage of signed pixel pairs; 0 outside the mask.

    Args:
        mask: Foreground.
        affinities: Logits of whether a pixel and its partner at each of `offsets(scale)` belong to the same object.
        embedding: Embedding of each pixel.
        bias: Added to the logits; larger values divide less.
        scale: Width of the image in units of 64 pixels.
        components: Parts of the foreground that share no object; None: one part.
    """
    labels = np.zeros(mask.shape, np.int64)
    count = int(np.count_nonzero(mask))
    if not count:
        return labels
    index = np.full(mask.shape, -1)
    index[mask] = np.arange(count)
    pairs, attractions = [], []
    for channel, offset in enumerate(offsets(scale)):
        here, there = shifted(mask.shape, offset)
        both = mask[here] & mask[there]
        if components is not None:
            both &= components[here] == components[there]
        one, other = index[here][both], index[there][both]
        pairs.append(np.stack([one, other]))
        attractions.append(affinities[channel][here][both] + bias)
    segments = average_linkage(count, np.hstack(pairs), np.hstack(attractions).astype(np.float64))
    labels[mask] = _join_small(embedding[:, mask].T, segments) + 1
    return labels


def _join_small(
    vectors: Float[np.ndarray, "pixel channel"], segments: Int64[np.ndarray, "pixel"]
) -> Int64[np.ndarray, "pixel"]:
    """Give the pixels of small segments to the large segment with the nearest embedding, if there is one."""
    large = np.bincount(segments)[segments] >= LEAST
    if large.all() or not large.any():
        return segments
    joined = segments.copy()
    joined[~large] = segments[large][KDTree(vectors[large]).query(vectors[~large])[1]]
    return np.unique(joined, return_inverse=True)[1].reshape(-1)
