"""Models that need no training, one file each, and what the benchmark must know of them.

A grid holds few values, each with a reason to be the best on some data; labels of the validation split choose.
"""

from itertools import product

from benchmark.models.classical.boxes import OracleVisibleBoxes, OracleVisibleMeans, PlaneHdbscanBoxes
from benchmark.models.classical.clip_tracker import ClipTracker
from benchmark.models.classical.convexity import Convexity
from benchmark.models.classical.floors import AllBackground, ConstantGrid, OneCluster, RandomSlots
from benchmark.models.classical.kmeans import KMeansXyzRgb
from benchmark.models.classical.oracles import OracleKSlots, OracleQuarterResolution, OracleSplitBackground
from benchmark.models.classical.plane_components import PlaneComponents
from benchmark.models.classical.plane_dbscan import PlaneDbscan
from benchmark.models.classical.plane_dbscan_tracked import PlaneDbscanTracked
from benchmark.models.classical.plane_hdbscan import PlaneHdbscan
from benchmark.models.model_spec import Builder, ModelSpec, Options


def _grid(**values: tuple[float, ...]) -> tuple[Options, ...]:
    """All combinations; the first of each is the default."""
    return tuple(dict(zip(values, chosen, strict=True)) for chosen in product(*values.values()))


# Pixels apart that still touch: fewer keep neighbours apart, more bridge holes and surfaces that are seen aslant.
DBSCAN = _grid(reach=(2.0, 1.5, 1.75, 2.25, 2.5, 3.0, 4.0))
# As much colour as tells two objects that touch apart, and no more than leaves the shades of one object together.
DBSCAN_COLOUR = _grid(colour=(1.25, 2.5, 4.0), reach=(2.0, 2.5, 3.0, 4.0))
# Small objects against specks of noise and parts of large objects.
HDBSCAN = _grid(least_cells=(4, 3, 5, 6, 8, 12))
# From the slope of one surface in neighbouring pixels up to the depth of an object.
COMPONENTS = _grid(step=(2.0, 0.75, 1.0, 1.5, 3.0, 4.5))
# Wider gaps bridge holes and oblique surfaces, narrower ones keep neighbours apart.
TRACKER = _grid(gap=(3.0, 2.0, 2.5, 3.5, 4.0))
# Each of the three cues from weak to decisive.
CONVEXITY = _grid(concavity=(2.0, 1.0, 3.0), colour=(2.0, 0.0), gap=(1.75, 2.1))
# Against a table of about a metre: from position alone to colour alone.
KMEANS = _grid(colour=(12.8, 0.0, 0.8, 3.2, 6.4, 25.6, 51.2))

PLANE = ("background slot", "camera pose", "plane")

FLOORS = {
    "one-cluster": ModelSpec(
        Builder(OneCluster), 1, "everything is one object", "floor", random=False, priors=("background slot",)
    ),
    "all-background": ModelSpec(
        Builder(AllBackground), 1, "everything is background", "floor", random=False, priors=("background slot",)
    ),
    "random-slots": ModelSpec(Builder(RandomSlots), 1, "every pixel draws its slot", "floor", priors=("slots",)),
    "constant-grid": ModelSpec(
        Builder(ConstantGrid), 1, "the same rectangles in every image", "floor", random=False, priors=("slots",)
    ),
}

CLASSICAL = {
    "plane-dbscan": ModelSpec(
        Builder(PlaneDbscan), 1, "RANSAC plane removal, then DBSCAN on the points", "classical", DBSCAN, priors=PLANE
    ),
    "plane-dbscan-colour": ModelSpec(
        Builder(PlaneDbscan), 1, "the same on points and colours", "classical", DBSCAN_COLOUR, priors=PLANE
    ),
    "plane-dbscan-tracked": ModelSpec(
        Builder(PlaneDbscanTracked),
        1,
        "plane-dbscan, its clusters followed over frames by nearest centroid",
        "classical",
        DBSCAN,
        priors=PLANE,
    ),
    "plane-hdbscan": ModelSpec(
        Builder(PlaneHdbscan), 1, "RANSAC plane removal, then HDBSCAN on the points", "classical", HDBSCAN, priors=PLANE
    ),
    "plane-components": ModelSpec(
        Builder(PlaneComponents),
        1,
        "RANSAC plane removal, then connected components of the depth image",
        "classical",
        COMPONENTS,
        priors=PLANE,
    ),
    "clip-tracker": ModelSpec(
        Builder(ClipTracker),
        1,
        "components of the clearest frame, followed through the clip by rigid registration",
        "classical",
        TRACKER,
        priors=PLANE,
    ),
    "convexity": ModelSpec(
        Builder(Convexity),
        1,
        "RANSAC plane removal, then divisions at concave edges, colour edges and gaps",
        "classical",
        CONVEXITY,
        priors=PLANE,
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
    "oracle-k-slots": ModelSpec(
        Builder(OracleKSlots),
        1,
        "the truth, as far as K slots reach",
        "oracle",
        random=False,
        uses_labels=True,
        priors=("slots", "background slot"),
    ),
    "oracle-quarter-resolution": ModelSpec(
        Builder(OracleQuarterResolution),
        1,
        "the truth at a quarter of the resolution",
        "oracle",
        random=False,
        uses_labels=True,
        priors=("background slot",),
    ),
    "oracle-split-background": ModelSpec(
        Builder(OracleSplitBackground),
        1,
        "the truth, its background in four slots",
        "oracle",
        random=False,
        uses_labels=True,
        priors=("background slot",),
    ),
}

POSED = {
    "plane-hdbscan-boxes": ModelSpec(
        Builder(PlaneHdbscanBoxes),
        1,
        "plane-hdbscan, with the smallest box around each segment as its pose",
        "classical",
        HDBSCAN,
        priors=PLANE,
    ),
    "oracle-visible-boxes": ModelSpec(
        Builder(OracleVisibleBoxes),
        1,
        "the truth, with the smallest box around an object's visible points as its pose",
        "oracle",
        random=False,
        uses_labels=True,
        priors=("background slot", "camera pose"),
    ),
    "oracle-visible-means": ModelSpec(
        Builder(OracleVisibleMeans),
        1,
        "the truth, with the mean of an object's visible points as its place",
        "oracle",
        random=False,
        uses_labels=True,
        priors=("background slot", "camera pose"),
    ),
}
"""What poses of models are to be held against; apart from the others, whose segmentations they repeat."""
