"""Statistics of a dataset."""

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from datagen.errors import UsageError
from datagen.inspect import imported
from datagen.schema import SceneRecord, decode_depth
from datagen.storage.reader import Dataset
from datagen.storage.spec import is_imported

MOVES = 0.005
"""Distance from its place in frame 0 above which an object counts as moving in a clip, metres."""

TOUCHES = 0.005
"""Gap below which two objects count as touching, metres."""

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)

DEPTH_SCENES = 50
"""Approximate number of scenes per split whose depth is read, spread evenly."""

_FINENESS = 10_000
"""Visible fractions are counted in steps of one part in this many."""

Summary = dict[str, Any]

_BOTH = ("objects/count", "objects/category", "objects/motion", "poses/position", "contacts/gap", "scene/attempts")
_SMALL = (*_BOTH, "contacts/impulse")
_TABLE = (*_BOTH, *(f"objects/{name}" for name in ("size", "color", "pattern", "material", "mass")))
_VISIBILITY = "visibility/visible_fraction"


def summary(folder: str | Path) -> Summary:
    """Statistics of a dataset as plain values; shares are 0 to 1, lengths in metres.

    Raises:
        DatagenError: the folder holds no complete dataset.
    """
    dataset = Dataset(folder)
    dataset.check_complete()
    if dataset.imported:
        return {**_facts(dataset), **imported.figures(dataset)}
    records = (record for split in dataset.splits for record in dataset.split(split).in_order(_SMALL))
    figures = {**_facts(dataset), **_contents(records, _rejections(dataset))}
    return {**figures, **_pixels(dataset)} if dataset.spec["resolution"] else figures


def run(folder: str | Path) -> None:
    """Print the figures of a dataset.

    Raises:
        DatagenError: the folder holds no complete dataset.
    """
    table = Table("figure", "value", title=escape(str(folder)), title_style="bold")
    for name, value in readable(summary(folder)).items():
        table.add_row(name.replace("_", " "), escape(_text(value)))
    Console().print(table)


def readable(figures: Summary) -> Summary:
    """Give sizes in usual notation, and leave out what a dataset does not have, such as the seed of an import."""
    shown: Summary = {}
    for name, value in figures.items():
        if name == "resolution" and value:
            shown[name] = "x".join(map(str, value))
        elif name == "bytes_per_image":
            shown["size_per_image"] = f"{value / 1024:.1f} KiB"
        elif value is not None:
            shown[name] = value
    return shown


def inspect(folder: str | Path, split: str, scene: int) -> None:
    """Print the facts of one scene.

    Raises:
        UsageError: there is no such split or scene.
        DatagenError: it has not been made yet, or its file is damaged.
    """
    scenes = Dataset(folder).split(split)
    if not 0 <= scene < len(scenes):
        raise UsageError(f"Split {split} has scenes 0 to {len(scenes) - 1}, but {scene} was requested.")
    if is_imported(scenes.spec):
        imported.inspect(scenes, scene)
        return
    record = scenes.read(scene, [*_TABLE, *({_VISIBILITY} & set(scenes.fields(scene)))])
    console = Console(width=max(Console().width, 120))
    console.print(object_table(record, f"{folder}: {split} scene {scene}"))
    console.print(f"attempts {record['scene/attempts']}   contacts (gap < 5 mm): {_contacts(record)}", markup=False)
    console.print(f"hash {scenes.hash(scene)}", soft_wrap=True, markup=False)


def object_table(record: SceneRecord, title: str) -> Table:
    """Table of one scene's objects, one per row."""
    columns = ["id", "category", "size (cm)", "colour", "pattern", "material", "mass (g)", "motion", "path (cm)"]
    table = Table(*columns, "visible", title=escape(title), title_style="bold")
    for row in range(int(record["objects/count"])):
        size = " x ".join(f"{100 * side:.1f}" for side in record["objects/size"][row])
        channels = np.clip(np.nan_to_num(255 * record["objects/color"][row, 0]), 0, 255)
        color = "#" + "".join(f"{round(float(channel)):02x}" for channel in channels)
        words = {name: _word(record[f"objects/{name}"][row]) for name in ("category", "pattern", "material", "motion")}
        names = {name: escape(word) for name, word in words.items()}
        cells = [str(row + 1), names["category"], size, f"[{color}]██[/] {color}", names["pattern"], names["material"]]
        cells += [f"{1000 * record['objects/mass'][row]:.0f}", names["motion"]]
        table.add_row(*cells, f"{100 * _path_length(record, row):.1f}", _visibility(record, row))
    return table


def _word(text: bytes) -> str:
    return bytes(text).decode()


def _path_length(record: SceneRecord, row: int) -> float:
    steps = np.diff(record["poses/position"][:, row].astype(np.float64), axis=0)
    return float(np.sum(np.sqrt(np.sum(steps**2, axis=1))))


def _visibility(record: SceneRecord, row: int) -> str:
    """Least and greatest share of the object that any frame and view shows."""
    if _VISIBILITY not in record:
        return "-"
    fractions = record[_VISIBILITY][:, :, row]
    return f"{100 * np.min(fractions):.0f}-{100 * np.max(fractions):.0f} %"


def _contacts(record: SceneRecord) -> str:
    count = int(record["objects/count"])
    least = np.min(record["contacts/gap"][:, : count + 1, : count + 1], axis=0)
    names = ["table", *(str(row + 1) for row in range(count))]
    pairs = itertools.combinations(range(count + 1), 2)
    return ", ".join(f"{names[a]}-{names[b]}" for a, b in pairs if least[a, b] < TOUCHES) or "none"


def _facts(dataset: Dataset) -> Summary:
    spec = dataset.spec
    images = sum(dataset.splits.values()) * spec["recipe"]["frames"] * dataset.views
    scenes = [dataset.split(split) for split in dataset.splits]
    size = sum(part.path(number).stat().st_size for part in scenes for number in range(len(part.shards)))
    return {
        "recipe": spec["recipe"]["name"],
        "seed": None if dataset.imported else spec["seed"],
        "renderer": spec["renderer"] and spec["renderer"]["name"],
        "resolution": spec["resolution"],
        "scenes": dataset.splits,
        "frames_per_scene": spec["recipe"]["frames"],
        "views": dataset.views,
        "images": images,
        "bytes_per_image": size / max(images, 1),
    }


def _rejections(dataset: Dataset) -> Counter[str]:
    splits = [dataset.split(split) for split in dataset.splits]
    return sum((scenes.rejections(index) for scenes in splits for index in range(len(scenes))), Counter[str]())


def _contents(records: Iterable[SceneRecord], rejections: Counter[str]) -> Summary:
    counts, categories, motions = Counter[int](), Counter[str](), Counter[str]()
    moving, colliding, touching = _Share(), _Share(), _Share()
    attempts = 0
    for record in records:
        count = int(record["objects/count"])
        counts[count] += 1
        categories.update(map(_word, record["objects/category"][:count]))
        motions.update(map(_word, record["objects/motion"][:count]))
        moving.add(_moves(record))
        colliding.add([_collides(record)])
        touching.add(_touches(record))
        attempts += int(record["scene/attempts"])
    return {
        "objects_per_scene": _histogram(counts),
        "categories": _histogram(categories),
        "motions": _histogram(motions),
        "moving_objects": moving.value,
        "colliding_clips": colliding.value,
        "touching_frames": touching.value,
        "attempts_per_scene": attempts / max(counts.total(), 1),
        "rejected": {reason: number / max(attempts, 1) for reason, number in rejections.most_common()},
    }


def _histogram(counts: Counter[Any]) -> dict[str, int]:
    return {str(value): number for value, number in sorted(counts.items())}


@dataclass
class _Share:
    """Mean of numbers that are not kept, such as the share of true flags; 0 without any."""

    total: float = 0.0
    number: int = 0

    def add(self, values: Sequence[float]) -> None:
        self.total += sum(values)
        self.number += len(values)

    @property
    def value(self) -> float:
        return self.total / max(self.number, 1)


def _moves(record: SceneRecord) -> list[bool]:
    """Whether each object moves in the clip."""
    away = record["poses/position"] - record["poses/position"][:1]
    farthest = np.sqrt(np.max(np.sum(away.astype(np.float64) ** 2, axis=-1), axis=0))
    return (farthest > MOVES)[: int(record["objects/count"])].tolist()


def _collides(record: SceneRecord) -> bool:
    """Whether two objects that were apart in frame 0 hit each other later."""
    count = int(record["objects/count"])
    apart = record["contacts/gap"][0, 1 : count + 1, 1 : count + 1] > TOUCHES
    return bool(np.any(apart & (record["contacts/impulse"][:, 1 : count + 1, 1 : count + 1] > 0)))


def _touches(record: SceneRecord) -> list[bool]:
    """Whether any two objects touch, for each frame."""
    count = int(record["objects/count"])
    gap = record["contacts/gap"][:, 1 : count + 1, 1 : count + 1] + np.diag([np.inf] * count)
    return np.any(gap < TOUCHES, axis=(1, 2)).tolist()


def _pixels(dataset: Dataset) -> Summary:
    fields = ("visibility/visible_pixels", _VISIBILITY, "visibility/amodal_pixels")
    width, height = dataset.spec["resolution"]
    foreground = {name: _Share() for name, size in {"all": 1, **dataset.splits}.items() if size}
    hidden, counts = _Share(), np.zeros(_FINENESS + 1, np.int64)
    for split in dataset.splits:
        for record in dataset.split(split).in_order(fields):
            share = float(np.mean(np.sum(record["visibility/visible_pixels"], axis=-1))) / (width * height)
            for name in ("all", split):
                foreground[name].add([share])
            fractions = record[_VISIBILITY][record["visibility/amodal_pixels"] > 0]
            hidden.add((fractions < 0.5).tolist())
            rounded = np.rint(np.clip(fractions, 0, 1) * _FINENESS).astype(np.int64)
            counts += np.bincount(rounded, minlength=len(counts))
    return {
        "foreground": {name: share.value for name, share in foreground.items()},
        "visible_fraction_quantiles": {f"{q:g}": _quantile(counts, q) for q in QUANTILES if counts.any()},
        "objects_less_than_half_visible": hidden.value,
        "depth_range": _depth_range(dataset),
    }


def _quantile(counts: np.ndarray, q: float) -> float:
    """Quantile of rounded fractions that were counted, interpolated as `numpy.quantile` does."""
    place, ends = q * (int(counts.sum()) - 1), np.cumsum(counts)
    low, high = (int(np.searchsorted(ends, rank, side="right")) for rank in (math.floor(place), math.ceil(place)))
    return (low + (high - low) * (place % 1)) / _FINENESS


def _depth_range(dataset: Dataset) -> list[float]:
    ranges = []
    for split, size in dataset.splits.items():
        scenes = dataset.split(split)
        for index in range(0, size, max(size // DEPTH_SCENES, 1)):
            depth = decode_depth(scenes.read(index, ["depth"], slice(0, 1))["depth"])
            ranges.append([np.min(depth[depth > 0], initial=np.inf), np.max(depth)])
    return [float(np.min(np.array(ranges)[:, 0])), float(np.max(np.array(ranges)[:, 1]))] if ranges else []


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return "  ".join(f"{key}: {_text(item)}" for key, item in value.items()) or "-"
    if isinstance(value, list | tuple):
        return " to ".join(_text(item) for item in value) if value and isinstance(value[0], float) else str(value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)
