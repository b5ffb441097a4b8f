"""Self-training (Scudder 1965): the network divides pseudo-objects that hold several objects, and learns from that.

Objects that touch are one connected component, and so one pseudo-object. The network learns borders from pasted
contacts. After half of the training it divides many of these components, and few single objects.
"""

import numpy as np
from jaxtyping import Int64, UInt8
from scipy.spatial import KDTree

START = 0.5
"""Share of the budget after which the network of that time divides the pseudo-objects."""
DIVISION_BIAS = 1.5
"""Bias of affinities for this division: large, so that few single objects are divided. It does not depend on the bias
that acts after training."""

Labels = UInt8[np.ndarray, "height width"]
"""Pseudo-objects of an image, from 1; 0 elsewhere."""


def divided(labels: Labels, other: Int64[np.ndarray, "height width"], *, least: int) -> Labels:
    """Divide pseudo-objects where another labelling does.

    Args:
        labels: Pseudo-objects from 1; 0 elsewhere.
        other: The other labelling, in the same form.
        least: Number of pixels from which a piece counts; smaller ones join the nearest piece that does.

    Returns:
        Pseudo-objects from 1; those of `labels` if there would be more than 255.
    """
    found, count = np.zeros(labels.shape, np.int64), 0
    for name in range(1, int(labels.max()) + 1):
        places = np.argwhere(labels == name)
        here = tuple(places.T)
        pieces = other[here]
        names, sizes = np.unique(pieces[pieces > 0], return_counts=True)
        large = names[sizes >= least]
        found[here] = count + 1
        if len(large) > 1:
            kept = np.isin(pieces, large)
            nearest = KDTree(places[kept]).query(places)[1]
            found[here] += np.searchsorted(large, pieces[kept][nearest])
        count += max(1, len(large))
    return labels if count > np.iinfo(labels.dtype).max else found.astype(labels.dtype)
