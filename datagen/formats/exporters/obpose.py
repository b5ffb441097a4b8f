"""The layout of the ObPose authors' YCB data: pickled NPY files of one clip, or of one view of a still scene.

Their camera has x to the left and y up, with negative focal lengths; pixels are counted at integer coordinates.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from datagen.errors import UsageError
from datagen.formats.exporters.interface import CAMERAS, PIXELS, Exporter, Files
from datagen.formats.scenes import ExportScene
from datagen.geometry import unproject
from datagen.rgbd.files import HALF_PIXEL

CAMERA_FILE = "camera_info.npy"
SLOTS = 5
"""Least number of mask channels of stills, which the authors' loader batches without padding."""

_Camera = dict[str, np.ndarray]

_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


def write(folder: Path, scenes: Iterable[ExportScene]) -> None:
    """Write `SPLIT/N.npy` and, for clips, `camera_info.npy`."""
    shared: _Camera | None = None
    for scene in scenes:
        (folder / scene.split).mkdir(exist_ok=True)
        for view in range(scene.views):
            frames = [_frame(scene, frame, view) for frame in range(scene.frames)]
            if scene.frames > 1:
                first: _Camera = frames[0]["misc"]
                shared = shared or first
                _check_camera(scene, frames, shared)
            content = np.empty(len(frames), object)
            content[:] = frames
            path = folder / scene.split / f"{scene.index * scene.views + view}.npy"
            np.save(path, content if scene.frames > 1 else np.array(frames[0], object), allow_pickle=True)
    if shared is not None:
        np.save(folder / CAMERA_FILE, np.array(shared, object), allow_pickle=True)


def _check_camera(scene: ExportScene, frames: list[dict[str, Any]], shared: _Camera) -> None:
    if any(not np.array_equal(frame["misc"][name], shared[name]) for frame in frames for name in shared):
        raise UsageError(
            f"{scene.place}: its cameras differ from those before, but the authors' loader knows one camera for all "
            f"clips; {scene.render_command('--views 1 --rig.jitter 0')}."
        )


def _frame(scene: ExportScene, frame: int, view: int) -> dict[str, Any]:
    depth, k, pose = scene.depth[frame, view], scene.k[frame, view], scene.world_from_camera[frame, view]
    channels = 1 + scene.objects if scene.frames > 1 else max(SLOTS, 1 + scene.objects)
    intrinsics = (k - HALF_PIXEL) @ np.diag([-1.0, -1.0, 1.0])
    return {
        "rgb": scene.rgb[frame, view].astype(np.float32) / np.float32(255),
        "depth": depth,
        "pcd": unproject(depth, k, pose).astype(np.float32),
        "mask_bin": np.eye(channels, dtype=np.uint8)[scene.segmentation[frame, view]],
        "obj_list": [{"name": name} for name in scene.categories],
        "misc": {
            "camera_intrinsics": intrinsics.astype(np.float32),
            "camera_extrinsics": (pose @ _TURN).astype(np.float32),
        },
    }


EXPORTER = Exporter(
    title="ObPose (NPY)",
    write=write,
    needs=(*PIXELS, *CAMERAS),
    files={"clips": Files("*/*.npy", "application/x-npy", "Pickled frames of one clip, or one view of a still scene.")},
    loading="""\
import numpy as np

frames = np.load("{folder}/{split}/0.npy", allow_pickle=True)  # runs code of the file: only for files that you trust
first = frames[0] if frames.ndim else frames.item()  # a clip, or one view of a still scene""",
    layout="""\
`SPLIT/N.npy` is a pickled list of frames, or one view of a still scene (N = scene times views plus view). Each is a
dictionary:

| key | content |
|---|---|
| `rgb` | float32 [height width 3], 0 to 1 |
| `depth` | float32 [height width], planar, metres, 0 = no return |
| `pcd` | float32 [height width 3], world points, metres |
| `mask_bin` | uint8 [height width channel], one-hot, background first; stills have at least 5 channels |
| `obj_list` | `name` of each object: its category |
| `misc` | `camera_intrinsics` and `camera_extrinsics` (camera to world) |

The camera's x axis points left and its y axis up, and focal lengths are negative. Pixels are counted at integers,
which moves the principal point by half a pixel. `camera_info.npy` is the one camera of all clips; the authors' code
expects it in `constants/`.""",
    loses="Object poses, shapes, physics, materials, flow, edits and the frame rate are left out. Cameras are rounded "
    "to float32.",
)
