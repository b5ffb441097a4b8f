"""How well are a user's own frames segmented, with weights and with methods without training?"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from benchmark.commands.segment import find_method
from benchmark.metrics import score
from benchmark.ranking.leaderboard import Cell, Line
from benchmark.studies.inputs import TableFlags
from datagen.errors import DatagenError, UsageError
from datagen.rgbd.camera_file import CAMERA, read_camera
from datagen.rgbd.files import read_ids
from datagen.rgbd.layouts import find_frames
from obpose.commands.segment import OBJECTS
from obpose.rgbd.frame_arguments import Frames
from obpose.rgbd.frames import Trained, prepare_frames
from obpose.rgbd.results import objects_of, overlay
from obpose.rgbd.segment import UNTRAINED, Method, segment_frames
from obpose.rgbd.weights import DEFAULT, method_of
from obpose.scenes.pictures import write_png

METRICS = ("ari_fg", "msc_fg", "miou_bg", "false_objects")
FALSE = 0.1
"""Segments with a smaller share of object pixels are false objects."""


@dataclass(frozen=True, kw_only=True)
class Flags(TableFlags):
    """Options of the study."""

    frames: Annotated[Path, tyro.conf.Positional]
    """Folder that `obpose-datagen import --format rgbd` accepts: recordings, each with a camera.json, and masks of the
    first frame if it is to be scored. `"mask": "predicted"` in camera.json says that they are no ground truth."""
    methods: tuple[str, ...] = ("plane-hdbscan", "obpose-contact--desk--128x96", DEFAULT)
    """Methods without training, names of shipped weights, or folders of models."""
    pictures: Path | None = None
    """Folder for an overlay of each frame and method."""


def run(flags: Flags) -> Iterator[Line]:
    """Segment every frame with every method, as obpose-segment does, and score those with a mask.

    The last rows are means, apart for masks that are predictions of another model.

    Raises:
        UsageError: the folder holds no frames, or a method does not exist.
        CorruptFile: a file cannot be read.
    """
    folders = [path for path in sorted(flags.frames.iterdir()) if (path / CAMERA).exists()]
    if not folders:
        raise UsageError(f"{flags.frames} holds no frames; expected folders with a camera.json each.")
    untrained = {name for name in flags.methods if "--" not in name and not Path(name).is_dir()}
    found = {name: (find_method(name), UNTRAINED) if name in untrained else method_of(name) for name in flags.methods}
    lines: list[Line] = []
    for folder in folders:
        for name, (method, trained) in found.items():
            lines.append(_segmented(folder, name, method, trained, flags.pictures))
            yield lines[-1]
    for masks, name in itertools.product(("ground truth", "predicted"), found):
        rows = [line for line in lines if (line["masks"], line["method"]) == (masks, Path(name).name)]
        if rows:
            means: Line = {metric: _mean([row[metric] for row in rows]) for metric in METRICS}
            yield {**rows[0], "frame": f"mean of {len(rows)}", "objects": nan, "note": "", **means}


def _mean(values: Sequence[Cell]) -> float:
    return float(np.nanmean(np.array(values, np.float64)))


def _segmented(folder: Path, name: str, method: Method, trained: Trained, pictures: Path | None) -> Line:
    """Segment the first frame of a recording, and score it."""
    files = find_frames(folder)
    line: Line = {"frame": folder.name, "method": Path(name).name, "masks": "none"}
    if files is None or files.camera is None:
        return {**line, "objects": 0, **dict.fromkeys(METRICS, nan), "note": "no colour images"}
    truth = read_ids(files.masks[0]) if files.masks else np.zeros(0, np.int64)
    if truth.max(initial=0) > 1:  # otherwise no objects are told apart
        line["masks"] = "predicted" if read_camera(files.camera).predicted else "ground truth"
    try:
        frames = prepare_frames(Frames(source=folder), trained)
    except DatagenError as error:
        return {**line, "objects": 0, **dict.fromkeys(METRICS, nan), "note": str(error)}
    labels = segment_frames(frames, method, most=OBJECTS)
    if pictures is not None:
        objects = objects_of(labels[0], frames.points(0))
        picture = overlay(frames.recording.rgb[0], labels[0], objects, frames, 0)
        write_png(pictures / f"{folder.name}--{line['method']}.png", picture)
    scores: Line = dict.fromkeys(METRICS, nan) if line["masks"] == "none" else _scores(truth, labels[0])
    return {**line, "objects": int(labels.max()), **scores, "note": " ".join(frames.warnings)}


def _scores(truth: np.ndarray, labels: np.ndarray) -> Line:
    found = score(truth[None], labels[None].astype(np.int64), 0)
    sizes, hits = (np.bincount(values.ravel(), minlength=256)[1:] for values in (labels, labels[truth > 0]))
    scores: Line = {name: float(found[name]) for name in METRICS[:3]}
    return scores | {"false_objects": int(np.sum(hits < FALSE * sizes))}
