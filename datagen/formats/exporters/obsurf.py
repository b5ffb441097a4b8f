"""ObSuRF's layout of CLEVR-3D: PNG images numbered over all splits, and camera positions in one NPZ file.

ObSuRF's loader knows one camera (320x240 pixels, 35 mm lens, aimed at the origin), so other images are refused.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from datagen.catalog import CATEGORIES
from datagen.errors import UsageError
from datagen.formats.exporters.interface import CAMERAS, PIXELS, Exporter, Files
from datagen.formats.images import write_png
from datagen.formats.scenes import ExportScene
from datagen.geometry import look_at, pixel_rays

UNITS_PER_METRE = 10.0
"""Scale of the world: objects of recipe clevr3d become as large as CLEVR's."""
STEPS_PER_UNIT = 65536 * 0.025
"""Steps of depth images per unit of the world."""
SIZE = (320, 240)
FOCAL = 350.0
MOST_OBJECTS = 10
FIRST = {"train": 0, "val": 70_000, "test": 85_000}
MOST = {"train": 70_000, "val": 500, "test": 15_000}
"""Numbers of the first image set and of all image sets of each split, fixed in ObSuRF's loader."""

_TOLERANCE = 0.05
"""Largest shift of a pixel by a camera that differs from ObSuRF's, pixels."""
_REMEDY = "--resolution 320x240 --rig.field-of-view 49.13434 --rig.target 0 0 0"


def write(folder: Path, scenes: Iterable[ExportScene], *, most: Mapping[str, int] = MOST) -> None:
    """Write `images/`, `depths/`, `masks/` and `metadata.npz` of at most so many image sets of each split."""
    rows: dict[int, dict[str, np.ndarray]] = {}
    counts = dict.fromkeys(FIRST, 0)
    for scene in scenes:
        for frame in range(scene.frames):
            number = FIRST[scene.split] + counts[scene.split]
            counts[scene.split] += 1
            if counts[scene.split] > most[scene.split]:
                raise UsageError(
                    f"ObSuRF's loader reads at most {most[scene.split]:,} {scene.split} scenes, and every frame is "
                    "one; the dataset has more. Export other splits, or a smaller dataset."
                )
            rows[number] = _write_images(folder, scene, frame, number)
    np.savez_compressed(folder / "metadata.npz", allow_pickle=False, **metadata(rows))


def metadata(rows: dict[int, dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays over all numbers up to the last; gaps get more objects than the loader accepts, so that it skips them."""
    first = next(iter(rows.values()))
    arrays = {name: np.zeros((max(rows) + 1, *array.shape), array.dtype) for name, array in first.items()}
    arrays["shape"][:] = 1
    for number, row in rows.items():
        for name, array in row.items():
            arrays[name][number] = array
    return arrays


def _write_images(folder: Path, scene: ExportScene, frame: int, number: int) -> dict[str, np.ndarray]:
    if scene.objects > MOST_OBJECTS:
        raise UsageError(f"{scene.place} has {scene.objects} objects; ObSuRF's format holds at most {MOST_OBJECTS}.")
    for view in range(scene.views):
        _check_camera(scene, frame, view)
        rays = pixel_rays(scene.k[frame, view], *SIZE)
        distance = scene.depth[frame, view] * np.linalg.norm(rays, axis=-1)
        name = f"{number}_{view}.png"
        write_png(folder / "images" / f"img_{name}", scene.rgb[frame, view])
        write_png(folder / "depths" / f"depths_{name}", _steps(distance))
        write_png(folder / "masks" / f"masks_{name}", scene.segmentation[frame, view])
    shape = np.zeros(MOST_OBJECTS, np.int32)
    shape[: scene.objects] = [_category_number(name) for name in scene.categories]
    positions = scene.world_from_camera[frame, :, :3, 3] * UNITS_PER_METRE
    return {"shape": shape, "camera_pos": positions.astype(np.float32)}


def _steps(distance: np.ndarray) -> np.ndarray:
    """Convert metres to steps; rays without return end at the greatest depth, as the format knows no missing depth."""
    steps = np.rint(distance * UNITS_PER_METRE * STEPS_PER_UNIT)
    return np.where((distance > 0) & (steps < 65535), steps, 65535).astype(np.uint16)


def _category_number(name: str) -> int:
    names = list(CATEGORIES)
    return names.index(name) + 1 if name in names else len(names) + 1


def _check_camera(scene: ExportScene, frame: int, view: int) -> None:
    """Check that ObSuRF's camera, aimed from this position, sees the same as the scene's."""
    remedy = scene.render_command(_REMEDY) + "."
    if scene.size != SIZE:
        width, height = scene.size
        raise UsageError(f"ObSuRF's loader reads images of 320x240 pixels, not {width}x{height}; {remedy}")
    pose, k = scene.world_from_camera[frame, view], scene.k[frame, view]
    expected = np.array([[FOCAL, 0, 160], [0, FOCAL, 120], [0, 0, 1]])
    try:
        aimed = look_at(pose[:3, 3], np.zeros(3))
    except ValueError:
        raise UsageError(
            f"{scene.place}, view {view}: the camera is straight above the origin or at it, where ObSuRF's camera has "
            f"no defined roll; {remedy}"
        ) from None
    turn = expected @ aimed[:3, :3].T @ pose[:3, :3] @ np.linalg.inv(k)
    corners = np.array([[0, 0, 1], [320, 0, 1], [0, 240, 1], [320, 240, 1]], np.float64)
    moved = corners @ turn.T
    shift = np.max(np.abs(moved[:, :2] / moved[:, 2:] - corners[:, :2]))
    if not shift <= _TOLERANCE:
        raise UsageError(
            f"{scene.place}, view {view}: ObSuRF's camera has a 35 mm lens and looks at the origin, and would place "
            f"pixels up to {shift:.0f} pixels away from this one; {remedy}"
        )


EXPORTER = Exporter(
    title="ObSuRF (CLEVR-3D)",
    write=write,
    needs=(*PIXELS, *CAMERAS),
    files={
        "images": Files("images/*.png", "image/png", "Colour images, img_SCENE_VIEW.png."),
        "depths": Files("depths/*.png", "image/png", "16-bit Euclidean depth, depths_SCENE_VIEW.png."),
        "masks": Files("masks/*.png", "image/png", "8-bit object ids, masks_SCENE_VIEW.png."),
        "metadata": Files("metadata.npz", "application/x-npz", "Camera positions and shapes of all scenes."),
    },
    loading="""\
import imageio.v3 as iio
import numpy as np

metadata = np.load("{folder}/metadata.npz")
scene, view = 0, 0  # val begins at scene 70000, test at 85000
image = iio.imread(f"{folder}/images/img_{{scene}}_{{view}}.png")
distance = iio.imread(f"{folder}/depths/depths_{{scene}}_{{view}}.png") / (65536 * 0.025)  # units of 10 cm
position = metadata["camera_pos"][scene, view]""",
    layout="""\
| file | content |
|---|---|
| `images/img_SCENE_VIEW.png` | colour, 320x240 |
| `depths/depths_SCENE_VIEW.png` | distance to the camera's centre, 16 bits, 1638.4 steps per unit |
| `masks/masks_SCENE_VIEW.png` | object ids, 8 bits, 0 = background |
| `metadata.npz` | `shape` [scene 10] (category number, 0 = none) and `camera_pos` [scene view 3] |

One unit of the world is 10 cm, so that objects of recipe `clevr3d` are as large as CLEVR's. Scenes are numbered from 0
(train), 70000 (val) and 85000 (test); each frame of a clip is a scene. Numbers in between have 10 objects, which
ObSuRF's loader skips (it takes at most 6).""",
    loses="Depth is rounded to 0.06 mm. Pixels without return, or beyond 4 m, have the greatest depth. Poses, names "
    "of categories, physics, materials, flow and edits are left out; so is the order of frames.",
)
