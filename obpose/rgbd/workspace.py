"""The part of a recording that is segmented: what stands on the visible table."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_closing, label
from scipy.spatial import ConvexHull, KDTree, QhullError

from datagen.rgbd.plane import TOLERANCE
from obpose.errors import NoTable

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

    def holds(self, points: Float[np.ndarray, "*shape 3"]) -> Bool[np.ndarray, "*shape"]:
        """Whether points are on the table or above it, within the outline."""
        inside = np.abs(points[..., 2]) < CEILING
        for corner, after in zip(self.outline, np.roll(self.outline, -1, axis=0), strict=True):
            along = (after - corner) / np.linalg.norm(after - corner)
            distance = (points[..., 0] - corner[0]) * along[1] - (points[..., 1] - corner[1]) * along[0]
            inside &= distance < self.rim
        return inside & (points[..., 2] > -MOST_FLOOR)

    def standing(
        self, points: Float[np.ndarray, "*shape 3"], depth: Float[np.ndarray, "*shape"], *, share: float = 1.0
    ) -> Bool[np.ndarray, "*shape"]:
        """Whether points are above the table by more than a share of its noise.

        Beyond the median depth of the table, noise grows with the square of depth (Khoshelham and Elberink 2012).
        """
        held = self.holds(points)
        table = held & (np.abs(points[..., 2]) < self.floor) & (depth > 0)
        middle = np.median(depth[table]) if table.any() else np.inf
        return held & (points[..., 2] > share * np.clip(self.floor * (depth / middle) ** 2, self.floor, MOST_FLOOR))


def find_workspace(points: Float[np.ndarray, "point 3"], at: Float[np.ndarray, "2"] | None = None) -> Workspace:
    """Find the visible part of the table at z = 0, and the noise of its points.

    The table's points are counted in cells. The largest region of occupied cells is the table, and its outline is the
    convex hull. So a floor or a table behind, at the same height but apart, does not belong to it.

    Args:
        points: World frame, metres.
        at: Place on the table; None for the largest region.

    Raises:
        NoTable: too few points are near z = 0.
    """
    on_table = points[np.abs(points[:, 2]) < TOLERANCE]
    cells = np.floor(on_table[:, :2] / CELL).astype(np.int64)
    outline = _outline(cells, at) if len(cells) else None
    if outline is None:
        raise NoTable(
            "No table is visible at z = 0; expected a camera that looks down at a table, depth in "
            "the right unit (--depth-scale), and a --camera-pose whose world has the table at z = 0, if one is given."
        )
    everything = Workspace(outline, 0.0)
    heights = on_table[everything.holds(on_table), 2]
    # The median is robust against the lower ends of objects; 1.4826 scales it to the deviation of a Gaussian.
    spread = 1.4826 * float(np.median(np.abs(heights - np.median(heights))))
    return Workspace(outline, float(np.clip(FLOOR_NOISE * spread, LEAST_FLOOR, MOST_FLOOR)))


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


def rectangle(corners: tuple[float, float, float, float], floor: float) -> Workspace:
    """Build a workspace from its least and greatest x, then y, metres."""
    (x0, x1, y0, y1) = corners
    return Workspace(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]), floor, rim=0.0)


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
