"""COCO: images with run-length encoded masks, and the same masks as video annotations in the style of YouTube-VIS."""

import json
from collections.abc import Iterable
from contextlib import ExitStack
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
from jaxtyping import Bool

from datagen.catalog import CATEGORIES
from datagen.formats.exporters.interface import Exporter, Files
from datagen.formats.images import write_png
from datagen.formats.scenes import ExportScene, view_name
from datagen.storage.run_lengths import run_lengths


def write(folder: Path, scenes: Iterable[ExportScene]) -> None:
    """Write `SPLIT/NAME/FRAME.png`, `annotations/instances_SPLIT.json` and, of clips, `annotations/videos_SPLIT.json`.

    Ids of categories are places in the catalog, so that all datasets agree; names that it lacks come after it.
    """
    categories = {name: number for number, name in enumerate(CATEGORIES, start=1)}
    (folder / "annotations").mkdir()
    for split, members in groupby(scenes, lambda scene: scene.split):
        with ExitStack() as stack:
            annotations = _Annotations(stack, categories)
            for scene in members:
                for view in range(scene.views):
                    annotations.add(folder / split, scene, view)
            annotations.save(folder / "annotations", split)


def _temporary() -> IO[str]:
    return TemporaryFile("w+", encoding="utf-8")


class _List:
    """A JSON list that is collected on disk, as annotations of many scenes do not fit into memory."""

    def __init__(self, stack: ExitStack):
        self._file: IO[str] = stack.enter_context(_temporary())
        self.length = 0

    def append(self, value: dict[str, Any]) -> None:
        self._file.write(",\n" if self.length else "\n")
        json.dump(value, self._file, separators=(",", ":"))
        self.length += 1

    def copy_to(self, file: IO[str]) -> None:
        self._file.seek(0)
        file.write("[")
        for line in self._file:
            file.write(line)
        file.write("\n]")


class _Annotations:
    """Annotations of one split."""

    def __init__(self, stack: ExitStack, categories: dict[str, int]):
        self._images, self._masks, self._videos, self._tracks = (_List(stack) for _ in range(4))
        self._categories = categories
        self._is_video = False

    def add(self, folder: Path, scene: ExportScene, view: int) -> None:
        """Write the images of one camera's clip, and note what they show."""
        name, video = view_name(scene, view), self._videos.length + 1
        width, height = scene.size
        size = {"width": width, "height": height}
        files = [f"{name}/{frame:06d}.png" for frame in range(scene.frames)]
        first_image = self._images.length + 1
        for frame, file in enumerate(files):
            write_png(folder / file, scene.rgb[frame, view])
            place = {"video_id": video, "frame_index": frame}
            self._images.append({"id": first_image + frame, "file_name": file, **size, **place})
        facts = {"fps": scene.fps, "scene": scene.index, "view": view}
        self._videos.append({"id": video, "file_names": files, **size, "length": scene.frames, **facts})
        self._is_video |= scene.frames > 1
        for row, category in enumerate(scene.categories):
            masks = [segmentation == row + 1 for segmentation in scene.segmentation[:, view]]
            kind = self._categories.setdefault(category, len(self._categories) + 1)
            facts = {"category_id": kind, "iscrowd": 0, "instance_id": row + 1}
            for frame, mask in enumerate(masks):
                if mask.any():
                    places = {"id": self._masks.length + 1, "image_id": first_image + frame}
                    self._masks.append({**places, **facts, **dict(zip(_SINGLE, _mask_facts(mask), strict=True))})
            if any(mask.any() for mask in masks):
                places = {"id": self._tracks.length + 1, "video_id": video}
                every = zip(*(_mask_facts(mask) for mask in masks), strict=True)
                lists = {name: list(values) for name, values in zip(_PLURAL, every, strict=True)}
                self._tracks.append({**places, **facts, **size, **lists})

    def save(self, folder: Path, split: str) -> None:
        """Write the files."""
        _save(
            folder / f"instances_{split}.json", {"images": self._images, "annotations": self._masks}, self._categories
        )
        if self._is_video:
            lists = {"videos": self._videos, "annotations": self._tracks}
            _save(folder / f"videos_{split}.json", lists, self._categories)


_SINGLE = ("segmentation", "bbox", "area")
_PLURAL = ("segmentations", "bboxes", "areas")


def _mask_facts(mask: Bool[np.ndarray, "height width"]) -> tuple[dict[str, Any] | None, list[int] | None, int | None]:
    """Encoded mask, box (x, y, width, height) and area; None for an empty mask."""
    if not mask.any():
        return None, None, None
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    left, top = int(columns[0]), int(rows[0])
    box = [left, top, int(columns[-1]) + 1 - left, int(rows[-1]) + 1 - top]
    # Plain counts, which all readers of COCO accept.
    return {"size": list(mask.shape), "counts": run_lengths(mask).tolist()}, box, int(np.count_nonzero(mask))


def _save(path: Path, lists: dict[str, _List], categories: dict[str, int]) -> None:
    with path.open("w", encoding="utf-8") as file:
        file.write('{"info":{"description":"Exported by obpose-datagen"},"licenses":[],\n"categories":')
        json.dump(
            [{"id": number, "name": name, "supercategory": "object"} for name, number in categories.items()], file
        )
        for name, values in lists.items():
            file.write(f',\n"{name}":')
            values.copy_to(file)
        file.write("}\n")


EXPORTER = Exporter(
    title="COCO",
    write=write,
    needs=("rgb", "segmentation"),
    files={
        "images": Files("*/*/*.png", "image/png", "Colour images."),
        "annotations": Files("annotations/*.json", "application/json", "Masks, boxes and categories."),
    },
    loading="""\
from pycocotools.coco import COCO

coco = COCO("{folder}/annotations/instances_{split}.json")
image = coco.loadImgs(1)[0]  # its file: {split}/ and image["file_name"]
masks = [coco.annToMask(each) for each in coco.loadAnns(coco.getAnnIds(imgIds=1))]""",
    layout="""\
| file | content |
|---|---|
| `SPLIT/NAME/FRAME.png` | colour; `NAME` is the scene, with the view if there are several |
| `annotations/instances_SPLIT.json` | one annotation per object and image: visible mask (uncompressed RLE), box, area |
| `annotations/videos_SPLIT.json` | clips only, in the style of YouTube-VIS: one annotation per object and clip |

Video annotations have lists `segmentations`, `bboxes` and `areas` over the frames, null where the object is hidden.
`instance_id` is the object's id in the source, constant over frames and views. `video_id` and `frame_index` of an image
lead to its clip.""",
    loses="Depth, cameras, poses, flow, physics, materials and edits are left out. Masks are exact.",
)
