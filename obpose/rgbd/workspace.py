"""The part of a recording that is segmented: what stands on the visible table."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_closing, label
from scipy.spatial import ConvexHull, KDTree, QhullError

from datagen.rgbd.plane import TOLERANCE
from obpose.errors import UsageError

CELL = 0.02
"""Side of the cells in which the table's points are counted, metres."""
CLOSING = 5
"""Gaps between cells up to this many cells belong to the table: objects and their shadows cover it."""
LEAST_FLOOR, MOST_FLOOR = 0.004, 0.02
"""Bounds of the height from which points belong to objects, metres."""
FLOOR_NOISE = 4.0
"""Height from which points belong to objects, in standard deviations of the table's points."""
CEILING = 0.6
"""Greatest height of objects, metres."""
RING, GROUND_QUANTILE, GROUND_SLOPE = 0.05, 0.1, 0.1
"""Width in metres of rings around the camera, share of a ring's points that are taken for the table, and greatest slope
of the table as it is measured. Objects hardly ever fill a ring, and they rise more steeply than the error of depth. Set
on scenes of `desk`, never on real frames."""
RIM = 0.03
"""Distance in metres by which objects may overhang the table."""


_WALL_HEIGHT, _BESIDE, _INSIDE = 0.04, 0.06, 0.03
"""Least height of the points of walls above the table, and greatest distances from its outline, metres."""
_MOST_WALLED, _MOST_BELOW = 0.5, 0.1
"""Greatest share of the outline with something beside it, and of points below the table. They suit the boxes that
`tests.worlds.rooms` draws, where one wall behind a table takes less; they were lowered after real frames were seen."""
UNSUPPORTED = (
    "Bins, shelves and walls are not supported, and the results are most likely wrong; if there is a table, name a "
    "pixel on it with --table."
)


@dataclass(frozen=True, eq=False)
class Workspace:
    """Space above the visible part of a table at z = 0, world frame."""

    outline: Float[np.ndarray, "corner 2"]
    """Corners of its convex outline on the table, counter-clockwise, metres."""
    floor: float
    """Height in metres from which points belong to objects."""
    rim: float = RIM
    """Distance in metres by which objects may overhang the outline."""
    ground: Float[np.ndarray, "ring"] = field(default_factory=lambda: np.zeros(1))
    """Height at which the table is measured, in rings of width `RING` around the camera: distant depth is biased."""

    def holds(self, points: Float[np.ndarray, "*shape 3"]) -> Bool[np.ndarray, "*shape"]:
        """Whether points are on the table or above it, within the outline."""
        inside = np.abs(points[..., 2]) < CEILING
        for corner, after in zip(self.outline, np.roll(self.outline, -1, axis=0), strict=True):
            along = (after - corner) / np.linalg.norm(after - corner)
            distance = (points[..., 0] - corner[0]) * along[1] - (points[..., 1] - corner[1]) * along[0]
            inside &= distance < self.rim
        return inside & (points[..., 2] > -MOST_FLOOR)

    def standing(
        self, points: Float[np.ndarray, "*shape 3"], camera: Float[np.ndarray, "3"], *, share: float = 1.0
    ) -> Bool[np.ndarray, "*shape"]:
        """Whether points are above the table, as the camera measures it, by more than a share of the floor."""
        rings = np.minimum(_rings(points, camera), len(self.ground) - 1)
        return self.holds(points) & (points[..., 2] - self.ground[rings] > share * self.floor)


def find_workspace(
    clouds: Sequence[Float[np.ndarray, "point 3"]],
    cameras: Float[np.ndarray, "cloud 3"],
    at: Float[np.ndarray, "2"] | None = None,
) -> Workspace:
    """Find the visible part of the table at z = 0, and the noise of its points.

    The table's points are counted in cells. The largest region of occupied cells is the table, and its outline is the
    convex hull. So a floor or a table behind, at the same height but apart, does not belong to it.

    Args:
        clouds: Points of some frames, world frame, metres.
        cameras: Position of the camera in each of them.
        at: Place on the table; None for the largest region.

    Raises:
        UsageError: too few points are near z = 0.
    """
    points = np.concatenate(clouds)
    on_table = points[np.abs(points[:, 2]) < TOLERANCE]
    cells = np.floor(on_table[:, :2] / CELL).astype(np.int64)
    outline = _outline(cells, at) if len(cells) else None
    if outline is None:
        raise UsageError(
            "No table is visible at z = 0 in the first frame; expected a camera that looks down at a table, depth in "
            "the right unit (--depth-scale), and a --camera-pose whose world has the table at z = 0, if one is given."
        )
    everything = Workspace(outline, 0.0)
    heights = on_table[everything.holds(on_table), 2]
    # The median is robust against the lower ends of objects; 1.4826 scales it to the deviation of a Gaussian.
    spread = 1.4826 * float(np.median(np.abs(heights - np.median(heights))))
    floor = float(np.clip(FLOOR_NOISE * spread, LEAST_FLOOR, MOST_FLOOR))
    rings = np.concatenate([_rings(cloud, camera) for cloud, camera in zip(clouds, cameras, strict=True)])
    kept = everything.holds(points)
    return Workspace(outline, floor, ground=_ground(points[kept, 2], rings[kept]))


def _rings(points: Float[np.ndarray, "*shape 3"], camera: Float[np.ndarray, "3"]) -> Int[np.ndarray, "*shape"]:
    """Number of each point's ring around the foot of the camera."""
    return (np.hypot(points[..., 0] - camera[0], points[..., 1] - camera[1]) / RING).astype(np.int64)


def _ground(heights: Float[np.ndarray, "point"], rings: Int[np.ndarray, "point"]) -> Float[np.ndarray, "ring"]:
    """Height of the lowest points in each ring, from the ring of the median distance outwards, with a limited slope."""
    ground = np.zeros(int(rings.max(initial=0)) + 1)
    ordered = heights[np.argsort(rings, kind="stable")]
    parts = np.split(ordered, np.cumsum(np.bincount(rings))[:-1]) if len(rings) else []
    for ring in range(int(np.median(rings)) + 1 if len(rings) else 0, len(ground)):
        lowest = np.quantile(parts[ring], GROUND_QUANTILE) if len(parts[ring]) else ground[ring - 1]
        ground[ring] = np.clip(lowest, 0, ground[ring - 1] + GROUND_SLOPE * RING)
    return ground


def doubts(
    points: Float[np.ndarray, "point 3"], workspace: Workspace, camera: Float[np.ndarray, "3"]
) -> tuple[str, ...]:
    """Say why the table is probably none: it has walls around it, or parts of the scene are seen through it.

    Args:
        points: World frame, metres.
        workspace: The visible part of the table.
        camera: Position of the camera, world frame, metres.
    """
    inner = replace(workspace, rim=-_INSIDE)
    within = inner.holds(points * (1, 1, 0))
    walls = points[(points[:, 2] > _WALL_HEIGHT) & ~within]
    share = float(np.mean(KDTree(walls[:, :2]).query(_rim_places(workspace))[0] < _BESIDE)) if len(walls) else 0.0
    low = points[(points[:, 2] < -_INSIDE) & (points[:, 2] > -CEILING)]
    crossed = camera + (low - camera) * (camera[2] / (camera[2] - low[:, 2:]))
    through = int(inner.holds(crossed * (1, 1, 0)).sum())
    below = through / max(1, through + int((within & (points[:, 2] > -_INSIDE)).sum()))
    found = []
    if share > _MOST_WALLED:
        found.append(f"Something rises beside {100 * share:.0f} % of the table's outline, as in a bin or a shelf.")
    if below > _MOST_BELOW:
        found.append(f"{100 * below:.0f} % of what is seen within the table's outline is below it, as in a bin.")
    return tuple(found)


def _rim_places(workspace: Workspace) -> Float[np.ndarray, "place 2"]:
    """Spread places along the outline, one in each cell."""
    corners, after = workspace.outline, np.roll(workspace.outline, -1, axis=0)
    counts = np.maximum(1, np.round(np.linalg.norm(after - corners, axis=1) / CELL)).astype(int)
    share = np.concatenate([(np.arange(count) + 0.5) / count for count in counts])
    return np.repeat(corners, counts, axis=0) + share[:, None] * np.repeat(after - corners, counts, axis=0)


def within(workspace: Workspace, corners: tuple[float, float, float, float]) -> Workspace:
    """Give a workspace the outline of a rectangle, from its least and greatest x, then y, metres."""
    (x0, x1, y0, y1) = corners
    return replace(workspace, outline=np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]), rim=0.0)


def _outline(cells: np.ndarray, at: np.ndarray | None) -> np.ndarray | None:
    """Convex hull of the largest region of occupied cells, or of the one at a place; None if it has no area."""
    first = cells.min(axis=0) - CLOSING
    grid = np.zeros(cells.max(axis=0) - first + 1 + CLOSING, bool)
    grid[tuple((cells - first).T)] = True
    regions = np.zeros(grid.shape, np.int32)
    label(binary_closing(grid, np.ones((CLOSING, CLOSING))), np.ones((3, 3)), output=regions)
    weight = np.bincount(regions[tuple((cells - first).T)])
    weight[0] = 0
    chosen = weight.argmax()
    if at is not None:
        places = np.argwhere(regions) + first
        chosen = regions[tuple(places[np.argmin(np.abs(CELL * places - at).sum(axis=1))] - first)]
    corners = np.argwhere(regions == chosen) + first
    if weight[chosen] < 3:
        return None
    places = CELL * np.concatenate([corners + offset for offset in ((0, 0), (1, 0), (0, 1), (1, 1))])
    try:
        return places[ConvexHull(places).vertices]
    except QhullError:
        return None
