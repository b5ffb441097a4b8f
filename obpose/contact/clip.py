"""Objects of a clip from the affinities of all its images and from the motion of their parts.

Groups of key frames are followed through the clip, some of them too coarse and some too fine. Parts that all of them
leave whole are fragments. Fragments belong to one object if the network joins them on average over the clip, and if
they move together.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int64
from scipy.spatial import KDTree

from obpose.contact.components import NEIGHBOURS, shifted
from obpose.contact.fragments import Evidence, Labels, fragments_of, gather
from obpose.contact.grouping import Pairs, group
from obpose.contact.motion.key_frames import evenly_spread
from obpose.contact.motion.rigidity import TOGETHER, common_motion
from obpose.contact.motion.tracking import COLOUR_SCALE, Cloud, track

FINER = 1.5
"""Subtracted from the bias for the finer of the two groupings of key frames."""
CAUTION = 0.75
"""Subtracted from attractions when parts are joined before motion is considered, and added to them afterwards, for ten
images: errors of single images cancel, so that fewer divisions are wrong. It is 0 for one image."""
LABELLED = 2.0
"""Logit of whether two pixels with the same label belong together; its negative for different labels."""
TEARING = 4000.0
"""Loss of attraction by different motion, per metre of excess residual beyond that of parts that move together."""
SLACK = 3.0
"""Excess residual that parts which move together may have beyond `TOGETHER`, in standard deviations of depth."""
MOST_TORN = 12.0
"""Largest loss of attraction by different motion, and gain of parts that turn over together."""
MOST_OBJECTS = 255
"""Smaller objects beyond this number become background: label images have 8 bits."""
FAR = 0.1
"""Distance in metres. In noisy images, a pixel with fewer than two others of its object so near is background."""


class Image(NamedTuple):
    """One image of a clip."""

    mask: Bool[np.ndarray, "height width"]
    """Foreground."""
    points: Float[np.ndarray, "height width 3"]
    """Surface points in metres, in one frame of reference with z upwards."""
    rgb: Float[np.ndarray, "height width 3"]
    """0 to 1."""
    pairs: Pairs
    """Affinities of foreground pixels."""
    embedding: Float[np.ndarray, "pixel channel"]
    """Embedding of each foreground pixel."""

    def groups(self, bias: float) -> Int64[np.ndarray, "pixel"]:
        """Label the objects of the foreground pixels, from 0, by this image alone."""
        return group(self.pairs, self.embedding, bias=bias)


class LabelledImage(NamedTuple):
    """One image that any method has segmented on its own; its labels take the place of affinities."""

    mask: Bool[np.ndarray, "height width"]
    """Foreground."""
    points: Float[np.ndarray, "height width 3"]
    """Surface points in metres, in one frame of reference with z upwards."""
    rgb: Float[np.ndarray, "height width 3"]
    """0 to 1."""
    labels: Int64[np.ndarray, "pixel"]
    """Object of each foreground pixel, from 0."""

    @property
    def pairs(self) -> Pairs:
        """Neighbours, which attract each other if they have the same label, and repel each other otherwise."""
        index = np.full(self.mask.shape, -1)
        index[self.mask] = np.arange(np.count_nonzero(self.mask))
        places = [[index[part] for part in shifted(self.mask.shape, offset)] for offset in NEIGHBOURS]
        pixels = np.hstack([np.stack(both)[:, np.minimum(*both) >= 0] for both in places])
        return Pairs(pixels, np.where(np.equal(*self.labels[pixels]), LABELLED, -LABELLED))

    def groups(self, bias: float) -> Int64[np.ndarray, "pixel"]:
        """Give the labels, whatever the bias."""
        return self.labels


def label_map(
    mask: Bool[np.ndarray, "height width"], labels: Int64[np.ndarray, "pixel"]
) -> Int64[np.ndarray, "height width"]:
    """Arrange labels of foreground pixels, from 0, as an image with labels from 1; 0 is the background."""
    found = np.zeros(mask.shape, np.int64)
    found[mask] = labels + 1
    return found


def segment_clip(
    images: Sequence[Image] | Sequence[LabelledImage], *, bias: float, gap: float, views: int = 1, noise: float = 0.0
) -> Int64[np.ndarray, "image height width"]:
    """Label the objects of a clip.

    Args:
        images: Images in the order of time; those of one time, one per view, follow each other.
        bias: Added to the logits of affinities in single images; larger values divide less.
        gap: Largest distance in metres of neighbouring points of a new object; points of no followed object start one.
        views: Number of views.
        noise: Standard deviation of depth, metres. In noisy images, specks far from the rest of their object count as
            background.

    Returns:
        Labels from 1 to at most `MOST_OBJECTS`, one for an object over time; 0 outside the masks.
    """
    clouds = [Cloud(image.points[image.mask], COLOUR_SCALE * image.rgb[image.mask]) for image in images]
    keys = evenly_spread(clouds)
    labels = (
        _over_time(images, clouds, keys, bias=bias, gap=gap, views=views, noise=noise)
        if keys
        else [image.groups(bias) for image in images]
    )
    if noise:
        labels = [
            np.where(_specks(cloud.points, found), -1, found) for cloud, found in zip(clouds, labels, strict=True)
        ]
    labels = _largest(labels)
    return np.stack([label_map(image.mask, found) for image, found in zip(images, labels, strict=True)])


def _over_time(
    images: Sequence[Image] | Sequence[LabelledImage],
    clouds: Sequence[Cloud],
    keys: Sequence[int],
    *,
    bias: float,
    gap: float,
    views: int,
    noise: float,
) -> Labels:
    """Label the objects of a clip, from 0, by following the groups of its key frames; see `segment_clip`."""
    coarse = {key: images[key].groups(bias) for key in keys}
    fine = {key: images[key].groups(bias - FINER) for key in keys}
    candidates = [track(clouds, key, coarse[key], gap) for key in keys]
    # Most key frames are grouped alike by both, and then followed alike.
    candidates += [
        found if np.array_equal(fine[key], coarse[key]) else track(clouds, key, fine[key], gap)
        for key, found in zip(keys, candidates, strict=True)
    ]
    # Errors of means over n images decrease with the root of n.
    caution = CAUTION * (1 - len(images) ** -0.5) / (1 - 10**-0.5)
    # Join fragments that the network joins in most images.
    labels, shared = fragments_of(candidates)
    evidence = gather(labels, shared, [image.pairs for image in images], bias=bias)
    labels, evidence = _join(labels, evidence, -caution)
    # Join larger parts unless they move apart, and those that turn over together.
    motion = common_motion(clouds, labels, views=views)
    torn = np.clip(TEARING * (motion.excess - TOGETHER - SLACK * noise), 0, MOST_TORN)
    torn[(torn == 0) & motion.tumbling] = -MOST_TORN
    return _join(labels, evidence._replace(attraction=evidence.attraction - torn), caution)[0]


def _largest(labels: Labels) -> Labels:
    """Number the `MOST_OBJECTS` largest objects of a clip from 0; the others become background, -1."""
    sizes = np.bincount(np.concatenate(labels) + 1)[1:]
    if len(sizes) <= MOST_OBJECTS:
        return labels
    new = np.full(len(sizes) + 1, -1)  # the last place is that of -1
    new[np.sort(np.argsort(-sizes, kind="stable")[:MOST_OBJECTS])] = np.arange(MOST_OBJECTS)
    return [new[found] for found in labels]


def _specks(points: Float[np.ndarray, "pixel 3"], labels: Int64[np.ndarray, "pixel"]) -> Bool[np.ndarray, "pixel"]:
    """Whether fewer than two other points of the object are within `FAR`; False where an object has fewer than three.

    A noisy sensor raises single points of the table. One of them would stretch the box of an object across the table.
    """
    alone = np.zeros(len(labels), bool)
    for label in np.unique(labels):
        mine = labels == label
        if np.count_nonzero(mine) >= 3:
            alone[mine] = KDTree(points[mine]).query(points[mine], k=3)[0][:, 2] > FAR
    return alone


def _join(labels: Labels, evidence: Evidence, offset: float) -> tuple[Labels, Evidence]:
    """Join fragments, and their evidence."""
    segments = evidence.segments(offset)
    return [segments[found] for found in labels], evidence.joined(segments)
