"""Plain RGB-D folders: PNG images, a camera file and poses, as `obpose-segment` and other RGB-D tools read them."""

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from datagen.formats.exporters.interface import CAMERAS, PIXELS, Exporter, Files
from datagen.formats.images import depth_units, write_png
from datagen.formats.scenes import ExportScene
from datagen.schema import DEPTH_SCALE


def write(folder: Path, scenes: Iterable[ExportScene]) -> None:
    """Write `SPLIT/NAME/`, or `SPLIT/NAME/viewV/` for several views, with images, camera, poses and objects."""
    for scene in scenes:
        place = folder / scene.split / scene.name
        for view in range(scene.views):
            _write_clip(place if scene.views == 1 else place / f"view{view}", scene, view)


def _write_clip(folder: Path, scene: ExportScene, view: int) -> None:
    depth = depth_units(scene.depth[:, view], DEPTH_SCALE)
    for frame in range(scene.frames):
        name = f"{frame:06d}.png"
        write_png(folder / "rgb" / name, scene.rgb[frame, view])
        write_png(folder / "depth" / name, depth[frame])
        write_png(folder / "masks" / name, scene.segmentation[frame, view])
    # Camera and objects; poses in one file if the camera rests.
    k, poses = scene.k[:, view], scene.world_from_camera[:, view]
    width, height = scene.size
    camera = {
        "width": width,
        "height": height,
        "fx": k[0, 0, 0],
        "fy": k[0, 1, 1],
        "cx": k[0, 0, 2],
        "cy": k[0, 1, 2],
        "pixel_center": 0.5,
        "depth_scale_m": DEPTH_SCALE,
        "fps": scene.fps,
    }
    objects = [{"id": row + 1, "category": category} for row, category in enumerate(scene.categories)]
    (folder / "camera.json").write_text(json.dumps(camera, indent=1) + "\n")
    (folder / "objects.json").write_text(json.dumps(objects, indent=1) + "\n")
    if np.all(poses == poses[0]):
        np.savetxt(folder / "world_from_camera.txt", poses[0], fmt="%.17g")
    else:
        (folder / "poses").mkdir()
        for frame, pose in enumerate(poses):
            np.savetxt(folder / "poses" / f"{frame:06d}.txt", pose, fmt="%.17g")


EXPORTER = Exporter(
    title="RGB-D folders",
    write=write,
    needs=(*PIXELS, *CAMERAS),
    files={
        "rgb": Files("**/rgb/*.png", "image/png", "Colour images."),
        "depth": Files("**/depth/*.png", "image/png", "16-bit planar depth in units of 0.1 mm, 0 = no return."),
        "masks": Files("**/masks/*.png", "image/png", "8-bit object ids, 0 = background."),
        "cameras": Files("**/camera.json", "application/json", "Intrinsics, size, depth unit and frame rate."),
    },
    loading="""\
import json
from pathlib import Path

import imageio.v3 as iio

clip = Path("{folder}/{split}/000000")  # several views: 000000/view0
camera = json.loads((clip / "camera.json").read_text())
rgb = iio.imread(clip / "rgb" / "000000.png")
depth = iio.imread(clip / "depth" / "000000.png") * camera["depth_scale_m"]  # metres, 0 = no return""",
    layout="""\
| file in `SPLIT/NAME/`, or `SPLIT/NAME/viewV/` | content |
|---|---|
| `rgb/FRAME.png` | colour |
| `depth/FRAME.png` | planar depth, 16 bits, units of `depth_scale_m` (0.1 mm) |
| `masks/FRAME.png` | object ids, 8 bits, 0 = background |
| `camera.json` | fx, fy, cx, cy in pixels, with the first pixel's centre at 0.5, 0.5; size, depth unit, frame rate |
| `world_from_camera.txt` | 4x4 pose, metres; if the camera moves, `poses/FRAME.txt` instead |
| `objects.json` | category of each id |""",
    loses="Poses, contacts, shapes, materials, visibility counts, flow and edits are left out. Pixels are exact.",
)
