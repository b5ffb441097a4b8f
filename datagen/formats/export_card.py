"""The card of an export: the README.md in its folder, with the header that the Hugging Face hub reads."""

from collections.abc import Mapping

from datagen.formats.exporters.interface import Exporter
from datagen.inspect.dataset_card import description_of, license_of, size_category
from datagen.storage.shard import CONVENTIONS
from datagen.storage.spec import Spec, views_of
from datagen.version import find_version


def export_card(spec: Spec, exporter: Exporter, counts: Mapping[str, int]) -> str:
    """Text of the card of an export.

    Args:
        spec: Spec of the dataset.
        exporter: Its new format.
        counts: Number of scenes of each exported split.
    """
    recipe = spec["recipe"]
    images = sum(counts.values()) * recipe["frames"] * views_of(spec)
    synthetic = "" if spec.get("import") else "- synthetic\n"
    scenes = ", ".join(f"{number} {split}" for split, number in counts.items())
    return f"""---
license: {license_of(spec).hub}
task_categories:
- image-segmentation
- depth-estimation
size_categories:
- {size_category(images)}
tags:
- object-centric-learning
- rgb-d
{synthetic}pretty_name: obpose {recipe["name"]} ({exporter.title})
{exporter.hub_config(counts)}---

# {recipe["name"]} as {exporter.title}

{description_of(spec)} Exported by `obpose-datagen export` {find_version()}.

| | |
|---|---|
| scenes | {scenes} |
| frames x views a scene | {recipe["frames"]} x {views_of(spec)} |
| resolution (width x height) | {"x".join(map(str, spec["resolution"]))} |
| frames per second | {recipe["fps"]:g} |

## Loading

```python
{exporter.loading.format(folder="path/to/this/folder", split=next(iter(counts)))}
```

## Layout

{exporter.layout}

## Not included

{exporter.loses}

## Conventions

Those of the source, unless the layout says otherwise. {CONVENTIONS}

## Identity

| | |
|---|---|
| recipe, seed | {recipe["name"]}, {spec["seed"]} |
| spec hash of the source | `{spec["spec_hash"]}` |
"""
