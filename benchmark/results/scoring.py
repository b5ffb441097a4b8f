"""Score stored label maps into scene tables; no model runs."""

from collections.abc import Iterator, Sequence
from itertools import islice, repeat
from pathlib import Path

from benchmark.clips import ClipSequence, has_true_poses, read_true_poses, read_truth
from benchmark.metrics import clip_scores_of, count_clip, other_scores
from benchmark.metrics.poses import pose_scores
from benchmark.metrics.score import ClipScores
from benchmark.results.labels import check_labels_fit, each_pose, labels_path, locate, read_labels
from benchmark.results.run_folder import RunRow, save_scenes, scene_line
from datagen.console.progress import Tracker, untracked
from datagen.errors import DatagenError
from datagen.storage.reader import Dataset, Split, read_depth

SPLIT = "test"
"""The split that is scored."""

BATCH = 16
"""Number of scenes scored together, which shares the overhead of small arrays."""


def score_labels(path: Path, scenes: Split, out: Path, name: str) -> int:
    """Score stored label maps, and poses if the file and the dataset have some, and write the scene table.

    Returns the number of frames; each view counts as a frame. Pixels without depth are ignored, as geometry gives no
    information about them.

    Raises:
        CorruptFile: the label maps do not fit the scenes.
    """
    check_labels_fit(path, scenes)
    frames = 0

    def lines() -> Iterator[dict[str, float | int]]:
        nonlocal frames
        for index, scores in enumerate(_scene_scores(path, scenes)):
            line = scene_line(index, scores)
            frames += int(line["n_frames"])
            yield line

    save_scenes(out, name, lines())
    return frames


def _scene_scores(path: Path, scenes: Split) -> Iterator[ClipScores]:
    """Score stored label maps and poses scene by scene; no more than a batch is in memory."""
    clips, poses = ClipSequence(scenes), each_pose(path) if has_true_poses(scenes) else repeat(None)
    predictions = enumerate(zip(read_labels(path), poses, strict=False))
    while batch := list(islice(predictions, BATCH)):
        counted, found = [], []
        for index, ((labels, slot), placed) in batch:
            truth, (_, valid) = read_truth(scenes, index), read_depth(scenes, index)
            counted.append(count_clip(truth, labels, slot, ~valid))
            found.append(clip_scores_of(counted[-1]))
            if placed is not None:
                true = read_true_poses(scenes, index, clips[index], truth)
                found[-1] |= pose_scores(true, placed, truth, labels, slot, ~valid)
        for one, two in zip(found, other_scores(counted), strict=True):
            yield one | two


def rescore(folder: Path, rows: Sequence[RunRow], data: Sequence[Path] = (), *, progress: Tracker = untracked) -> int:
    """Recompute the scene tables of all finished rows of a run folder from their label maps; return their number.

    The datasets are searched in the folders `data` first.

    Raises:
        DatagenError: the label maps or the dataset of a row are missing.
        CorruptFile: label maps are damaged.
    """
    finished = [row for row in rows if row.status == "ok"]
    # Find all before writing any table, so that an incomplete folder stays unchanged.
    found = [_find(folder, row, data) for row in finished]
    for row, (labels, dataset) in progress(list(zip(finished, found, strict=True)), "scoring rows"):
        score_labels(labels, Dataset(dataset).split(SPLIT), folder, row.key.name)
    return len(finished)


def _find(folder: Path, row: RunRow, data: Sequence[Path]) -> tuple[Path, Path]:
    """Find the label maps and the dataset of a row."""
    labels = labels_path(folder, row)
    if not labels.exists():
        raise DatagenError(f"{labels} is missing; label maps stay on the machine that made them. Run there.")
    dataset = locate(folder, row, data)
    if dataset is None:
        raise DatagenError(f"The dataset of {row.key.name} is not on this machine; name its folder with --data.")
    return labels, dataset
