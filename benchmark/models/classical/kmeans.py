"""k-means on position and colour of all points, table included, with K slots and without a background."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int64

from benchmark.models.classical.points import Untrained, scene_points
from benchmark.models.interface import Clip, Prediction

SAMPLE = 4096
"""Number of points that determine the centres; the others are only assigned to them."""
STARTS = 4
"""Number of initial guesses (k-means++) in a clip's first frame; the best is used."""

Centres = Float[np.ndarray, "slot feature"]


@dataclass
class KMeansXyzRgb(Untrained):
    """k-means with a slot for every cluster; implements `Segmenter`. It declares no background."""

    slots: int
    """K."""
    colour: float = 12.8
    """Distance in metres from black to full red, green or blue."""

    def segment(self, clip: Clip) -> Prediction:
        """Start from the centres of the previous frame, so that slots keep their objects; holes get slot 0."""
        features = np.concatenate([scene_points(clip), self.colour * (clip.rgb / 255)], axis=-1)
        labels = np.zeros(clip.depth.shape, np.int64)
        rng, centres = np.random.default_rng(self.seed), None
        for frame, valid in enumerate(clip.valid):
            seen = features[frame][valid]
            if len(seen) >= self.slots:
                centres = _move(seen, self.slots, centres, rng)
            if centres is not None:
                labels[frame][valid] = _nearest(seen, centres)
        return Prediction(labels, background_slot=None)


def _move(
    features: Float[np.ndarray, "point feature"], slots: int, centres: Centres | None, rng: np.random.Generator
) -> Centres:
    """Find the centres of a frame, from those of the previous frame or from scratch."""
    from sklearn.cluster import KMeans  # late: scikit-learn takes a second to import

    sample = features if len(features) <= SAMPLE else features[rng.integers(len(features), size=SAMPLE)]
    start: dict[str, Any] = (
        {"init": "k-means++", "n_init": STARTS} if centres is None else {"init": centres, "n_init": 1}
    )
    return KMeans(slots, **start, random_state=int(rng.integers(1 << 31))).fit(sample).cluster_centers_


def _nearest(features: Float[np.ndarray, "point feature"], centres: Centres) -> Int64[np.ndarray, "point"]:
    squares = np.sum(centres**2, axis=1) - 2 * features @ centres.T
    return np.argmin(squares, axis=1)
