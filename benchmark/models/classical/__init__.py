"""Models that need no training, one file each, with the facts that the benchmark needs about them.

A grid holds the few values that may be best on some data; labels of the validation split choose among them.
"""

from itertools import product

from benchmark.models.classical.boxes import OracleVisibleBoxes, OracleVisibleMeans, PlaneHdbscanBoxes
from benchmark.models.classical.clip_tracker import ClipTracker
from benchmark.models.classical.convexity import Convexity
from benchmark.models.classical.floors import AllBackground, ConstantGrid, OneCluster, RandomSlots
from benchmark.models.classical.kmeans import KMeansXyzRgb
from benchmark.models.classical.oracles import OracleKSlots, OracleQuarterResolution, OracleSplitBackground
from benchmark.models.classical.plane_components import PlaneComponents
from benchmark.models.classical.plane_dbscan import PlaneDbscan, PlaneDbscanTracked
from benchmark.models.classical.plane_hdbscan import PlaneHdbscan
from benchmark.models.interface import Segmenter
from benchmark.models.model_spec import Builder, ModelSpec, Options


def _grid(**values: tuple[float, ...]) -> tuple[Options, ...]:
    """Combine all values; the first value of each option is the default."""
    return tuple(dict(zip(values, chosen, strict=True)) for chosen in product(*values.values()))


# Distance of neighbours in pixels: small values separate objects, large ones bridge holes and slanted surfaces.
DBSCAN = _grid(reach=(2.0, 1.5, 1.75, 2.25, 2.5, 3.0, 4.0))
# Enough colour to separate touching objects, and little enough to keep the shades of one object together.
DBSCAN_COLOUR = _grid(colour=(1.25, 2.5, 4.0), reach=(2.0, 2.5, 3.0, 4.0))
# Small values keep small objects; large ones suppress specks of noise and parts of large objects.
HDBSCAN = _grid(least_cells=(4, 3, 5, 6, 8, 12))
# From the slope of one surface between neighbouring pixels to the depth of an object.
COMPONENTS = _grid(step=(2.0, 0.75, 1.0, 1.5, 3.0, 4.5))
# Wider gaps bridge holes and oblique surfaces, narrower ones keep neighbours apart.
TRACKER = _grid(gap=(3.0, 2.0, 2.5, 3.5, 4.0))
# Each of the three cues from weak to decisive.
CONVEXITY = _grid(concavity=(2.0, 1.0, 3.0), colour=(2.0, 0.0), gap=(1.75, 2.1))
# From position alone to colour alone, on a table of about a metre.
KMEANS = _grid(colour=(12.8, 0.0, 0.8, 3.2, 6.4, 25.6, 51.2))

PLANE = ("background slot", "camera pose", "plane")


def _floor(model: type[Segmenter], description: str, prior: str, *, random: bool = False) -> ModelSpec:
    return ModelSpec(Builder(model), 1, description, "floor", random=random, priors=(prior,))


def _plane(model: type[Segmenter], description: str, grid: tuple[Options, ...]) -> ModelSpec:
    return ModelSpec(Builder(model), 1, description, "classical", grid, priors=PLANE)


def _oracle(model: type[Segmenter], description: str, *priors: str) -> ModelSpec:
    return ModelSpec(Builder(model), 1, description, "oracle", random=False, uses_labels=True, priors=priors)


FLOORS = {
    "one-cluster": _floor(OneCluster, "everything is one object", "background slot"),
    "all-background": _floor(AllBackground, "everything is background", "background slot"),
    "random-slots": _floor(RandomSlots, "every pixel draws its slot", "slots", random=True),
    "constant-grid": _floor(ConstantGrid, "the same rectangles in every image", "slots"),
}

CLASSICAL = {
    "plane-dbscan": _plane(PlaneDbscan, "RANSAC plane removal, then DBSCAN on the points", DBSCAN),
    "plane-dbscan-colour": _plane(
        PlaneDbscan, "RANSAC plane removal, then DBSCAN on points and colours", DBSCAN_COLOUR
    ),
    "plane-dbscan-tracked": _plane(
        PlaneDbscanTracked, "plane-dbscan, its clusters followed over frames by nearest centroid", DBSCAN
    ),
    "plane-hdbscan": _plane(PlaneHdbscan, "RANSAC plane removal, then HDBSCAN on the points", HDBSCAN),
    "plane-components": _plane(
        PlaneComponents, "RANSAC plane removal, then connected components of the depth image", COMPONENTS
    ),
    "kmeans-xyz-rgb": ModelSpec(
        Builder(KMeansXyzRgb),
        1,
        "k-means on positions and colours of all points",
        "classical",
        KMEANS,
        priors=("slots", "camera pose"),
    ),
}

ORACLES = {
    "oracle-k-slots": _oracle(OracleKSlots, "the truth, as far as K slots reach", "slots", "background slot"),
    "oracle-quarter-resolution": _oracle(
        OracleQuarterResolution, "the truth at a quarter of the resolution", "background slot"
    ),
    "oracle-split-background": _oracle(
        OracleSplitBackground, "the truth, its background in four slots", "background slot"
    ),
}

POSED = {
    "plane-hdbscan-boxes": _plane(
        PlaneHdbscanBoxes, "plane-hdbscan, with the smallest box around each segment as its pose", HDBSCAN
    ),
    "oracle-visible-boxes": _oracle(
        OracleVisibleBoxes,
        "the truth, with the smallest box around an object's visible points as its pose",
        "background slot",
        "camera pose",
    ),
    "oracle-visible-means": _oracle(
        OracleVisibleMeans,
        "the truth, with the mean of an object's visible points as its place",
        "background slot",
        "camera pose",
    ),
}
"""Baselines for the poses of models, listed apart because their segmentations repeat those of other models."""

STRONGER = {
    "clip-tracker": ModelSpec(
        Builder(ClipTracker),
        1,
        "components of the clearest frame, followed through the clip by rigid registration",
        "classical",
        TRACKER,
        uses_time=True,
        priors=PLANE,
    ),
    "convexity": ModelSpec(
        Builder(Convexity),
        1,
        "RANSAC plane removal, then divisions at concave edges, colour edges and gaps",
        "classical",
        CONVEXITY,
        priors=PLANE,
        labelled_trials=140,
    ),
}
"""Stronger baselines; they are not part of the group `training-free`."""
