"""Fragments of the objects of a clip: the parts that none of several labellings divides; and what joins them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64

from obpose.contact.grouping import Pairs
from obpose.contact.linkage import average_linkage

AGREEMENT, DISTANT_AGREEMENT = 1.0, 2.0
"""Attraction of two fragments that all labellings join, and repulsion of those that all divide: per pair of pixels with
an affinity, and in the term of `OVER_TIME`."""
MOST_DISTANT_BIAS = 0.5
"""Upper limit of the bias in the term of `OVER_TIME`: a larger one would join distant objects."""
OVER_TIME = 0.1
"""Weight of the labellings' agreement about two fragments that need not be neighbours in any image, per pixel of the
smaller one: it joins the parts of an object that are visible at different times."""
MOST_FRAGMENTS = 1000
"""Smaller fragments beyond this number join others."""

Labels = list[Int64[np.ndarray, "_"]]
"""Labels of the foreground pixels of each image, from 0."""


class Evidence(NamedTuple):
    """Evidence on whether fragments belong to one object."""

    attraction: Float[np.ndarray, "fragment fragment"]
    """Mean attraction of each pair, symmetric."""
    weight: Float[np.ndarray, "fragment fragment"]
    """Weight of each pair, symmetric; 0 on the diagonal."""

    def segments(self, offset: float) -> Int64[np.ndarray, "fragment"]:
        """Join fragments by average linkage; `offset` is added to every attraction, so that larger ones divide less."""
        pairs = np.stack(np.nonzero(np.triu(self.weight, 1)))
        known = tuple(pairs)
        return average_linkage(len(self.weight), pairs, self.attraction[known] + offset, self.weight[known])

    def joined(self, segments: Int64[np.ndarray, "fragment"]) -> "Evidence":
        """Give the evidence on pairs of segments."""
        member = np.eye(segments.max(initial=-1) + 1)[segments]
        weight, total = (member.T @ matrix @ member for matrix in (self.weight, self.weight * self.attraction))
        np.fill_diagonal(weight, 0)
        return Evidence(total / np.where(weight > 0, weight, 1), weight)


def fragments_of(labellings: Sequence[Labels]) -> tuple[Labels, Int64[np.ndarray, "fragment labelling"]]:
    """Find the parts of a clip that none of several labellings divides.

    Returns:
        The fragment of each foreground pixel, and the labels of each fragment in the labellings.
    """
    lengths = [len(found) for found in labellings[0]]
    pixels = np.stack([np.concatenate(labelling) for labelling in labellings], axis=1)
    shared, names, sizes = np.unique(pixels, axis=0, return_inverse=True, return_counts=True)
    if len(shared) > MOST_FRAGMENTS:
        order = np.argsort(-sizes, kind="stable")
        kept = shared[order[:MOST_FRAGMENTS]]
        similar = [int((kept == each).sum(axis=1).argmax()) for each in shared]
        shared, names = kept, np.array(similar)[names]
    return np.split(names.reshape(-1).astype(np.int64), np.cumsum(lengths)[:-1]), shared


def gather(
    fragments: Labels, shared: Int64[np.ndarray, "fragment labelling"], pairs: Sequence[Pairs], *, bias: float
) -> Evidence:
    """Sum up the affinities of pixels over all images, and the agreement of the labellings.

    Args:
        fragments: The fragment of each foreground pixel.
        shared: Labels of each fragment in several labellings.
        pairs: Affinities of the foreground pixels of each image.
        bias: Added to the logits of affinities, and up to `MOST_DISTANT_BIAS` to the agreement; larger values divide
            less.
    """
    count = len(shared)
    ends = np.hstack([names[each.pixels] for names, each in zip(fragments, pairs, strict=True)])
    logits = np.concatenate([each.logits for each in pairs])
    place = ends.min(axis=0) * count + ends.max(axis=0)
    number, total = (np.bincount(place, values, count * count).reshape(count, count) for values in (None, logits))
    agreement = np.mean([2 * _equal(column) - 1 for column in shared.T], axis=0)
    sizes = np.bincount(np.concatenate(fragments), minlength=count)
    distant = OVER_TIME * np.minimum(sizes[:, None], sizes)
    weight = number + distant
    near = total + number * (AGREEMENT * agreement + bias)
    far = distant * (DISTANT_AGREEMENT * agreement + min(bias, MOST_DISTANT_BIAS))
    attraction = (near + far) / np.where(weight > 0, weight, 1)
    upper = np.triu(np.ones((count, count), bool), 1)
    weight, attraction = (np.where(upper, each, 0) for each in (weight, attraction))
    return Evidence(attraction + attraction.T, weight + weight.T)


def _equal(labels: Int64[np.ndarray, "fragment"]) -> Bool[np.ndarray, "fragment fragment"]:
    return labels[:, None] == labels
