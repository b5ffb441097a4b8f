"""Grouping of an image's foreground pixels into objects, from affinities and embeddings."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64, Integer
from scipy.spatial import KDTree

from obpose.contact.components import offsets, shifted
from obpose.contact.linkage import average_linkage

LEAST = 3
"""Segments of fewer pixels join the nearest larger one."""
MOST_SEGMENTS = 255
"""Smaller segments beyond this number join the nearest larger one, too. It bounds the cost of following them through a
clip, for weights that divide nearly everything."""


class Pairs(NamedTuple):
    """Pairs of foreground pixels of an image."""

    pixels: Int64[np.ndarray, "2 pair"]
    """The two pixels, numbered along the rows of the foreground."""
    logits: Float[np.ndarray, "pair"]
    """Logits of whether the two belong to the same object."""


def foreground_pairs(
    mask: Bool[np.ndarray, "height width"],
    affinities: Float[np.ndarray, "offset height width"],
    *,
    scale: int = 1,
    components: Integer[np.ndarray, "height width"] | None = None,
) -> Pairs:
    """Collect the pairs of foreground pixels whose affinity is known.

    Args:
        mask: Foreground.
        affinities: Logits of whether a pixel and its partner at each of `offsets(scale)` belong to the same object.
        scale: Width of the training images in units of 64 pixels.
        components: Parts of the foreground that share no object; None: one part.
    """
    index = np.full(mask.shape, -1)
    index[mask] = np.arange(np.count_nonzero(mask))
    pairs, logits = [], []
    for channel, offset in enumerate(offsets(scale)):
        here, there = shifted(mask.shape, offset)
        both = mask[here] & mask[there]
        if components is not None:
            both &= components[here] == components[there]
        pairs.append(np.stack([index[here][both], index[there][both]]))
        logits.append(affinities[channel][here][both])
    return Pairs(np.hstack(pairs), np.hstack(logits).astype(np.float64))


def group(pairs: Pairs, embedding: Float[np.ndarray, "pixel channel"], *, bias: float) -> Int64[np.ndarray, "pixel"]:
    """Label the objects of an image, from 0, by average linkage of signed pixel pairs.

    Args:
        pairs: Pairs of foreground pixels.
        embedding: Embedding of each foreground pixel.
        bias: Added to the logits; larger values divide less.
    """
    return _join_small(embedding, average_linkage(len(embedding), pairs.pixels, pairs.logits + bias))


def _join_small(
    vectors: Float[np.ndarray, "pixel channel"], segments: Int64[np.ndarray, "pixel"]
) -> Int64[np.ndarray, "pixel"]:
    """Give the pixels of small segments to the large segment with the nearest embedding; all are large if none is."""
    sizes = np.bincount(segments)
    kept = sizes >= LEAST if (sizes >= LEAST).any() else sizes > 0
    kept[np.argsort(-np.where(kept, sizes, 0), kind="stable")[MOST_SEGMENTS:]] = False
    large = kept[segments]
    if large.all():
        return segments
    joined = segments.copy()
    joined[~large] = segments[large][KDTree(vectors[large]).query(vectors[~large])[1]]
    return np.unique(joined, return_inverse=True)[1]
