"""WebDataset: tar files with one sample per clip, under the names that MOVi's users know.

The loaders of VideoSAUR and SlotContrast read `video.npy`, `segmentations.npy` and `forward_flow.npy` unmodified.
"""

import io
import json
import tarfile
from collections.abc import Iterable, Iterator
from itertools import groupby, islice
from pathlib import Path

import numpy as np

from datagen.formats.exporters.interface import CAMERAS, PIXELS, Exporter, Files
from datagen.formats.scenes import ExportScene, plain, view_name

SAMPLES_PER_SHARD = 32
"""Loaders give whole shards to their workers, so that small ones keep all of them busy."""


def write(folder: Path, scenes: Iterable[ExportScene], *, samples_per_shard: int = SAMPLES_PER_SHARD) -> None:
    """Write `SPLIT-NNNNNN.tar` files."""
    for split, members in groupby(scenes, lambda scene: scene.split):
        samples = (sample for scene in members for sample in _samples(scene))
        for number, first in enumerate(samples):
            with tarfile.open(folder / f"{split}-{number:06d}.tar", "w", format=tarfile.USTAR_FORMAT) as shard:
                _add(shard, *first)
                for sample in islice(samples, samples_per_shard - 1):
                    _add(shard, *sample)


def _samples(scene: ExportScene) -> Iterator[tuple[str, dict[str, bytes]]]:
    for view in range(scene.views):
        arrays = {
            "video": scene.rgb[:, view],
            "segmentations": scene.segmentation[:, view, ..., None],
            "depth": scene.depth[:, view, ..., None],
        }
        for direction in ("forward", "backward"):
            if scene.has_flow(direction):
                arrays[f"{direction}_flow"] = scene.flow(direction, view)[..., ::-1]
        files = {f"{name}.npy": _npy(array) for name, array in arrays.items()}
        yield view_name(scene, view), {**files, "scene.json": json.dumps(facts(scene, view)).encode()}


def facts(scene: ExportScene, view: int) -> dict[str, object]:
    """Camera and objects of one clip."""
    return {
        "split": scene.split,
        "scene": scene.index,
        "view": view,
        "fps": scene.fps,
        "K": plain(scene.k[:, view]),
        "world_from_camera": plain(scene.world_from_camera[:, view]),
        "objects": [{"id": row + 1, "category": category} for row, category in enumerate(scene.categories)],
        **({"world_from_object": _poses(scene)} if scene.has("poses/position", "poses/quaternion_wxyz") else {}),
    }


def _poses(scene: ExportScene) -> dict[str, object]:
    names = ("position", "quaternion_wxyz")
    return {name: plain(scene.per_object(f"poses/{name}", axis=1)) for name in names}


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, np.ascontiguousarray(array), allow_pickle=False)
    return file.getvalue()


def _add(shard: tarfile.TarFile, key: str, files: dict[str, bytes]) -> None:
    """Add a sample's files; equal samples give equal bytes, whoever writes them and when."""
    for name, data in files.items():
        entry = tarfile.TarInfo(f"{key}.{name}")
        entry.size = len(data)
        shard.addfile(entry, io.BytesIO(data))


def _hub_config(splits: Iterable[str]) -> str:
    """Tell the hub which shards belong to which split."""
    files = "".join(f"  - split: {split}\n    path: {split}-*.tar\n" for split in splits)
    return f"configs:\n- config_name: default\n  data_files:\n{files}"


EXPORTER = Exporter(
    title="WebDataset",
    write=write,
    needs=(*PIXELS, *CAMERAS),
    files={"shards": Files("*.tar", "application/x-tar", "Samples of up to 32 clips; one clip per camera.")},
    loading="""\
import datasets

clips = datasets.load_dataset("webdataset", data_files={{"{split}": "{folder}/{split}-*.tar"}}, split="{split}")
video = clips.with_format("numpy")[0]["video.npy"]""",
    layout="""\
| file of a sample | array | meaning |
|---|---|---|
| `video.npy` | uint8 [frame height width 3] | colour, sRGB |
| `segmentations.npy` | uint8 [frame height width 1] | object ids, 0 = background |
| `depth.npy` | float32 [frame height width 1] | planar depth in metres, 0 = no return |
| `forward_flow.npy`, `backward_flow.npy` | float32 [frame height width 2] | (row, column), pixels; if known |
| `scene.json` | | camera matrices, `world_from_camera` poses, categories and poses of the objects, frame rate |""",
    loses="Contacts, masses, shapes, materials, visibility counts and edits are left out. Pixels and poses are exact.",
    hub_config=_hub_config,
)
