"""How well are a user's own frames segmented, with weights and with methods without training?"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from benchmark.commands.segment import find_method
from benchmark.metrics import score
from benchmark.ranking.leaderboard import Line
from benchmark.studies.inputs import TableFlags
from datagen.errors import DatagenError, UsageError
from datagen.storage.safe_io import open_image, read_json
from obpose.rgbd.frame_arguments import Frames
from obpose.rgbd.frames import prepare_frames
from obpose.rgbd.results import objects_of, overlay
from obpose.rgbd.segment import UNTRAINED, segment_frames
from obpose.rgbd.weights import DEFAULT, method_of
from obpose.scenes.pictures import write_png

METRICS = ("ari_fg", "msc_fg", "miou_bg", "false_objects")
FALSE = 0.1
"""Segments with a smaller share of object pixels are false objects."""


@dataclass(frozen=True, kw_only=True)
class Flags(TableFlags):
    """Options of the study."""

    frames: Annotated[Path, tyro.conf.Positional]
    """Folder with a folder for each frame: color.png, depth.png, camera.json (`intrinsics_for_obpose`: fx,fy,cx,cy in
    pixels with pixel centres at +0.5, and `depth_scale_m`), and mask.png (objects from 1) if it is to be scored."""
    methods: tuple[str, ...] = ("plane-hdbscan", "obpose-contact--desk--128x96", DEFAULT)
    """Methods without training, names of shipped weights, or folders of models."""
    pictures: Path | None = None
    """Folder for an overlay of each frame and method."""


def run(flags: Flags) -> Iterator[Line]:
    """Segment every frame with every method, as obpose-segment does, and score those with a mask.

    Raises:
        UsageError: the folder holds no frames, or a method does not exist.
        CorruptFile: a file cannot be read.
    """
    folders = sorted(path.parent for path in flags.frames.glob("*/camera.json"))
    if not folders:
        raise UsageError(f"{flags.frames} holds no frames; expected folders with a camera.json each.")
    untrained = {name for name in flags.methods if "--" not in name and not Path(name).is_dir()}
    found = {name: (find_method(name), UNTRAINED) if name in untrained else method_of(name) for name in flags.methods}
    for folder in folders:
        camera = read_json(folder / "camera.json")
        values = Frames(
            rgb=(folder / "color.png",),
            depth=(folder / "depth.png",),
            intrinsics=camera["intrinsics_for_obpose"],
            depth_scale=camera["depth_scale_m"],
        )
        for name, (method, trained) in found.items():
            line: Line = {"frame": folder.name, "method": Path(name).name}
            try:
                frames = prepare_frames(values, trained)
            except DatagenError as error:
                yield {**line, "objects": 0, **dict.fromkeys(METRICS, nan), "note": str(error)}
                continue
            labels = segment_frames(frames, method)
            if flags.pictures is not None:
                picture = overlay(frames.recording.rgb[0], labels[0], objects_of(labels[0], frames.points(0)), frames)
                write_png(flags.pictures / f"{folder.name}--{line['method']}.png", picture)
            yield {**line, "objects": int(labels.max()), **_scores(folder / "mask.png", labels), "note": ""}


def _scores(mask: Path, labels: np.ndarray) -> Line:
    """Scores against a mask; nan without one, or if it tells no objects apart."""
    if not mask.exists():
        return dict.fromkeys(METRICS, nan)
    with open_image(mask) as image:
        truth = np.asarray(image)[None].astype(np.int64)
    if truth.max() < 2:
        return dict.fromkeys(METRICS, nan)
    found = score(truth, labels.astype(np.int64), 0)
    sizes, hits = (np.bincount(values.ravel(), minlength=256)[1:] for values in (labels, labels[truth > 0]))
    false = int(np.count_nonzero(hits < FALSE * sizes))
    return {**{name: float(found[name]) for name in METRICS[:3]}, "false_objects": false}
