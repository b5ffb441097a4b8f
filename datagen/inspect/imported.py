"""Statistics, card and facts of imported datasets, of whose scenes only images and perhaps masks are known."""

from collections import Counter
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from datagen.schema import SPLITS, decode_depth
from datagen.storage.reader import Dataset, Split
from datagen.storage.shard import CONVENTIONS
from datagen.storage.spec import Spec

DEPTH_SCENES = 50
"""Approximate number of scenes per split whose depth is read, spread evenly."""


def figures(dataset: Dataset) -> dict[str, Any]:
    """Statistics of an imported dataset; shares are 0 to 1, lengths in metres."""
    splits = {name: dataset.split(name) for name, size in dataset.splits.items() if size}
    labelled = {name: scenes for name, scenes in splits.items() if scenes.has("segmentation")}
    depths = [_depth_facts(scenes, index) for scenes in splits.values() for index in _sample(len(scenes))]
    near, far, missing = np.array(depths).T if depths else np.zeros((3, 1))
    origin = dataset.spec["import"]
    return {
        "imported_from": f"{origin['source']} ({origin['format']})",
        "world": origin["world"],
        "splits_with_masks": ", ".join(labelled) or "none",
        "objects_per_scene": _counts(labelled),
        "categories": _categories(labelled),
        "foreground": {name: _foreground(scenes) for name, scenes in labelled.items()},
        "depth_range": [float(near.min()), float(far.max())],
        "pixels_without_depth": float(missing.mean()),
    }


def _sample(size: int) -> range:
    return range(0, size, max(size // DEPTH_SCENES, 1))


def _depth_facts(scenes: Split, index: int) -> tuple[float, float, float]:
    """Least and greatest depth of the first frame, and its share of pixels without depth."""
    depth = decode_depth(scenes.read(index, ["depth"], slice(0, 1))["depth"])
    known = depth[depth > 0]
    return float(np.min(known, initial=np.inf)), float(np.max(known, initial=0)), float(np.mean(depth == 0))


def _counts(labelled: dict[str, Split]) -> dict[str, int]:
    counts = Counter(
        int(scenes.read(index, ["objects/count"])["objects/count"])
        for scenes in labelled.values()
        for index in range(len(scenes))
    )
    return {str(count): number for count, number in sorted(counts.items())}


def _categories(labelled: dict[str, Split]) -> dict[str, int]:
    names: Counter[str] = Counter()
    for scenes in labelled.values():
        if scenes.has("objects/category"):
            for index in range(len(scenes)):
                record = scenes.read(index, ["objects/count", "objects/category"])
                names.update(bytes(name).decode() for name in record["objects/category"][: record["objects/count"]])
    return dict(sorted(names.items()))


def _foreground(scenes: Split) -> float:
    """Mean share of an image's pixels that show objects."""
    width, height = scenes.spec["resolution"]
    name = "visibility/visible_pixels"
    visible = [np.mean(np.sum(scenes.read(index, [name])[name], axis=-1)) for index in range(len(scenes))]
    return float(np.mean(visible) / (width * height))


def inspect(scenes: Split, scene: int) -> None:
    """Print the facts of one imported scene."""
    small = ("objects/count", "objects/category", "visibility/visible_pixels", "camera/K", "camera/world_from_camera")
    record = scenes.read(scene, [name for name in small if scenes.has(name)])
    console = Console(width=max(Console().width, 120))
    title = f"{scenes.folder}: {scenes.name} scene {scene}"
    if "objects/count" in record:
        table = Table("id", "category", "pixels by image", title=escape(title), title_style="bold")
        for row in range(int(record["objects/count"])):
            pixels = record["visibility/visible_pixels"][..., row]
            names = record.get("objects/category")
            name = "-" if names is None else bytes(names[row]).decode()
            table.add_row(str(row + 1), escape(name), f"{pixels.min()} to {pixels.max()}")
        console.print(table)
    else:
        console.print(f"{title}, without masks", markup=False)
    for view, (k, pose) in enumerate(zip(record["camera/K"], record["camera/world_from_camera"], strict=True)):
        x, y, z = pose[:3, 3]
        console.print(
            f"view {view}: fx {k[0, 0]:.1f} fy {k[1, 1]:.1f} cx {k[0, 2]:.1f} cy {k[1, 2]:.1f}; camera at "
            f"({x:.3f}, {y:.3f}, {z:.3f}) m",
            markup=False,
        )
    console.print(f"hash {scenes.hash(scene)}", soft_wrap=True, markup=False)


def card(spec: Spec, facts: dict[str, Any]) -> str:
    """The text of the card; its licence is that of the source."""
    origin = spec["import"]
    rows = [(name.replace("_", " "), value) for name, value in facts.items()]
    table = "\n".join(f"| {name} | {str(value).replace('|', ' ')} |" for name, value in rows)
    fields = "\n".join(f"- {split}: {', '.join(spec['fields'][split]) or 'no scenes'}" for split in SPLITS)
    return f"""---
license: other
task_categories:
- image-segmentation
- depth-estimation
tags:
- object-centric-learning
- rgb-d
pretty_name: {origin["format"]} import
---

# {origin["source"]}

Imported from format `{origin["format"]}` with `{spec["generator"]}`. The licence is that of the source.

| | |
|---|---|
{table}

## Fields

Other fields of the format are unknown.

{fields}

## Conventions

{CONVENTIONS}

## Identity

| | |
|---|---|
| spec hash | `{spec["spec_hash"]}` |
| data version, format version | {spec["data_version"]}, {spec["format_version"]} |
"""
