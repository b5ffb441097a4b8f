"""RGB-D frames of users."""

import json
import shutil
from pathlib import Path

import numpy as np
from PIL import Image

from datagen.schema import decode_depth
from datagen.storage.reader import Dataset
from tests.fuzz.worlds.group import DATASET, MODEL, Group, Target, run


def build_frames(world: Path) -> None:
    """Frames of one camera in all formats."""
    run(f"obpose-datagen {DATASET} --split test=1 --out {world}/data")
    clip = Dataset(world / "data").split("test")[0]
    shutil.rmtree(world / "data")
    for name in ("rgb-png", "rgb-jpg", "depth-png", "depth-tif", "depth-npy"):
        (world / name).mkdir()
    for frame, (rgb, stored) in enumerate(zip(clip["rgb"][:, 0], clip["depth"][:, 0], strict=True)):
        Image.fromarray(rgb).save(world / f"rgb-png/{frame}.png")
        Image.fromarray(rgb).save(world / f"rgb-jpg/{frame}.jpg")
        Image.fromarray(stored).save(world / f"depth-png/{frame}.png")
        Image.fromarray(decode_depth(stored)).save(world / f"depth-tif/{frame}.tif")
        np.save(world / f"depth-npy/{frame}.npy", decode_depth(stored))
    pose = clip["camera/world_from_camera"][0]
    np.savetxt(world / "pose.txt", pose)
    np.save(world / "pose.npy", pose)
    (world / "pose.json").write_text(json.dumps(pose.tolist()))


def _frames(rgb: str, depth: str, pose: str = "") -> list[str]:
    flags = f"--checkpoint {MODEL} --rgb {{w}}/rgb-{rgb} --depth {{w}}/depth-{depth} --depth-scale 0.0001 --out {{o}}"
    # The focal length of the recipe's cameras, in images of 16x16.
    flags += " --intrinsics 21.98,21.98,8,8"
    flags += f" --camera-pose {{w}}/{pose}" if pose else ""
    return [f"obpose-segment {flags}", f"obpose-edit infer {flags} --refine 0 --resolution 8x8"]


IN_WORDS = ("first frame", "--rgb names", "--depth names")
"""Names in messages of images that do not fit one another."""

FRAMES = Group(
    build_frames,
    [
        Target("rgb-png/0.png", [*_frames("png", "png"), *_frames("png", "png", "pose.txt")], 4, IN_WORDS),
        Target("rgb-jpg/1.jpg", [*_frames("jpg", "npy"), *_frames("jpg", "npy", "pose.txt")], 3, IN_WORDS),
        Target("depth-png/0.png", [*_frames("png", "png"), *_frames("png", "png", "pose.txt")], 4, IN_WORDS),
        Target("depth-tif/1.tif", [*_frames("png", "tif"), *_frames("png", "tif", "pose.txt")], 3, IN_WORDS),
        Target("depth-npy/0.npy", [*_frames("png", "npy"), *_frames("png", "npy", "pose.txt")], 4, IN_WORDS),
        Target("pose.txt", _frames("png", "png", "pose.txt"), 2),
        Target("pose.json", _frames("png", "png", "pose.json"), 2),
        Target("pose.npy", _frames("png", "png", "pose.npy"), 2),
    ],
)
