"""How well is each frame of a real table segmented? Reads runs of obpose-bench on the track real-table."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from benchmark.clips import read_truth
from benchmark.ranking.leaderboard import Line
from benchmark.results.labels import dataset_of, labels_path, read_labels
from benchmark.results.run_folder import load_runs, load_scenes
from benchmark.studies.inputs import TableFlags
from datagen.errors import UsageError
from datagen.storage.reader import Dataset
from datagen.tracks import REAL_TABLE, REAL_TABLES
from obpose.pictures import tint
from obpose.rgbd.results import OPACITY
from obpose.scenes.pictures import write_png

METRICS = ("ari_fg", "msc_fg", "miou_bg")
FALSE = 0.1
"""Segments with a smaller share of object pixels are false objects."""


@dataclass(frozen=True, kw_only=True)
class Flags(TableFlags):
    """Options of the study."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Run folder with results on track real-table."""
    pictures: Path | None = None
    """Folder for a picture of each frame and model: its labels over its colours."""


def run(flags: Flags) -> Iterator[Line]:
    """List the scores of every frame; the last line of each model and track is their mean.

    Raises:
        UsageError: the folder has no results on that track.
        CorruptFile: a file cannot be read.
    """
    rows = [row for row in load_runs(flags.folder) if row.key.track in REAL_TABLES and row.status == "ok"]
    if not rows:
        raise UsageError(f"{flags.folder} has no results on track {REAL_TABLE}; make some with obpose-bench.")
    for row in sorted(rows, key=lambda row: row.key.place):
        path, table = labels_path(flags.folder, row), load_scenes(flags.folder, row)
        scenes, lines = Dataset(dataset_of(path)).split("test"), []
        names = scenes.spec.get("import", {}).get("recordings", {}).get("test") or [*map(str, range(len(scenes)))]
        for index, (labels, slot) in enumerate(read_labels(path)):
            truth = read_truth(scenes, index)
            labels = np.where(labels == slot, 0, np.where(labels == 0, slot, labels))  # 0 is the background
            if flags.pictures is not None:
                picture = tint(scenes.read(index, ["rgb"])["rgb"][0, 0], labels[0, 0], OPACITY)
                write_png(
                    flags.pictures / f"{index:02d}-{names[index]}--{row.key.model}-{row.key.seed}.png",
                    np.asarray(picture),
                )
            sizes, hits = (np.bincount(values.ravel(), minlength=256)[1:] for values in (labels, labels[truth > 0]))
            found: Line = {name: float(table[name][index]) for name in METRICS}
            found["false objects"] = int(np.sum(hits < FALSE * sizes))
            lines.append(found)
            yield {"masks": row.key.track, "frame": names[index], "model": row.key.model, **found}
        means = {name: float(np.nanmean([float(line[name] or 0) for line in lines])) for name in lines[0]}
        yield {"masks": row.key.track, "frame": f"mean of {len(lines)}", "model": row.key.model, **means}
