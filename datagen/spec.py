"""What a dataset is: the content of its `dataset.json`, decided before anything is made.

The spec is a plain dict:
    format_version, data_version, generator
    recipe .......... every constant of the recipe; its `resolution` is the one that sampling judges visibility by
    seed
    resolution ...... width and height of the images, null where there are none
    renderer ........ name and version, null where there are no images
    rig ............. cameras that replace the recipe's when rendering (`rig`, `views`), usually null
    edits ........... counterfactual edits, in the order of `schema.EDITS`; not there where there are none
    scenes_per_shard
    splits .......... number of scenes of each split
    spec_hash ....... SHA-256 of all this: the dataset's identity
"""

import hashlib
import json
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from datagen.config import Recipe, recipe_from_dict
from datagen.errors import CorruptFile, UsageError
from datagen.schema import DATA_VERSION, EDITS, FORMAT_VERSION, GENERATOR, SPLITS, EditKind

SPEC_FILE = "dataset.json"
MANIFEST_FILE = "manifest.json"
CARD_FILE = "README.md"

_MOST_SCENES_PER_SHARD = 64
_MOST_BYTES_PER_SHARD = 2**30
_BYTES_PER_PIXEL = 9  # rgb, depth, segmentation, sensor depth and validity
_BYTES_PER_EDITED_PIXEL = 7  # rgb, depth, segmentation, effects

Spec = dict[str, Any]


def make_spec(
    recipe: Mapping[str, Any],
    *,
    seed: int,
    splits: Mapping[str, int],
    resolution: tuple[int, int] | None,
    renderer: Mapping[str, Any] | None,
    rig: Mapping[str, Any] | None = None,
    edits: Collection[EditKind] = (),
) -> Spec:
    """The spec of a dataset; `recipe` and `rig` as plain values."""
    views = rig["views"] if rig else recipe["views"]
    width, height = resolution or (0, 0)
    pixel_bytes = _BYTES_PER_PIXEL + len(edits) * _BYTES_PER_EDITED_PIXEL
    scene_bytes = recipe["frames"] * views * width * height * pixel_bytes
    spec = {
        "format_version": FORMAT_VERSION,
        "data_version": DATA_VERSION,
        "generator": GENERATOR,
        "recipe": recipe,
        "seed": seed,
        "resolution": resolution,
        "renderer": renderer,
        "rig": rig,
        "scenes_per_shard": max(1, min(_MOST_SCENES_PER_SHARD, _MOST_BYTES_PER_SHARD // max(1, scene_bytes))),
        "splits": {name: int(splits.get(name, 0)) for name in SPLITS},
    }
    if edits:
        # Datasets without edits keep the identity that they had before there were any.
        spec["edits"] = [kind for kind in EDITS if kind in edits]
    spec = json.loads(json.dumps(spec))
    return {**spec, "spec_hash": _digest(spec)}


def with_splits(spec: Spec, splits: Mapping[str, int]) -> Spec:
    """The same settings with other numbers of scenes."""
    changed = {key: value for key, value in spec.items() if key != "spec_hash"}
    changed["splits"] = {name: int(splits.get(name, 0)) for name in SPLITS}
    return {**changed, "spec_hash": _digest(changed)}


def spec_text(spec: Spec) -> str:
    """What stands in `dataset.json`."""
    return json.dumps(spec, indent=2, allow_nan=False) + "\n"


def settings_hash(spec: Spec) -> str:
    """SHA-256 of what decides a scene: all but the numbers of scenes."""
    return _digest({key: value for key, value in spec.items() if key not in ("splits", "spec_hash")})


def _digest(values: Mapping[str, Any]) -> str:
    text = json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def split_sizes(scenes: int) -> dict[str, int]:
    """N scenes as 80/10/10; of every ten, the second is a test and the third a validation scene, the others train.

    Every size only grows with N, so that a dataset can be extended: 1 -> 1/0/0, 2 -> 1/0/1, 3 -> 1/1/1, 10 -> 8/1/1.
    """
    test, val = (scenes + 8) // 10, (scenes + 7) // 10
    return {"train": scenes - val - test, "val": val, "test": test}


def shard_name(split: str, number: int) -> str:
    """File name of a split's shard."""
    return f"{split}-{number:05d}.h5"


def shard_ranges(scenes: int, per_shard: int) -> list[range]:
    """Indices of the scenes of each shard of a split."""
    return [range(start, min(start + per_shard, scenes)) for start in range(0, scenes, per_shard)]


def read_spec(folder: Path) -> Spec:
    """Read a dataset's spec.

    Raises:
        UsageError: the folder holds no dataset, or one of another format version.
        CorruptFile: the file is damaged.
    """
    path = folder / SPEC_FILE
    try:
        spec = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise UsageError(
            f"{folder} holds no dataset: it has no {SPEC_FILE}; give a folder made by {GENERATOR}."
        ) from None
    except ValueError as error:
        raise CorruptFile(
            f"{path} is damaged ({error}); restore it, or make the dataset anew with --overwrite."
        ) from None
    if not isinstance(spec, dict) or spec.get("generator") != GENERATOR:
        raise UsageError(f"{path} was not written by {GENERATOR}; give a folder made by it.")
    if spec.get("format_version") != FORMAT_VERSION:
        found = spec.get("format_version")
        raise UsageError(f"{path} has format version {found}, this program reads {FORMAT_VERSION}; update the program.")
    if spec.get("spec_hash") != _digest({key: value for key, value in spec.items() if key != "spec_hash"}):
        raise CorruptFile(f"{path} was changed after it was written: its spec_hash does not fit; restore the original.")
    if wrong := [key for key, fits in _FITS.items() if not _holds(fits, spec.get(key))]:
        raise CorruptFile(f"{path} is no spec: {', '.join(wrong)} missing or malformed; restore the original.")
    return spec


def edits_of(spec: Spec) -> tuple[EditKind, ...]:
    """The counterfactual edits of a dataset, in the order of `schema.EDITS`."""
    return tuple(kind for kind in EDITS if kind in spec.get("edits", ()))


def views_of(spec: Spec) -> int:
    """Number of cameras of a dataset of this spec: of the rig that it was rendered with, or else of its recipe."""
    return (spec["rig"] or spec["recipe"])["views"]


def groups_of(spec: Spec) -> tuple[str, ...]:
    """Groups of fields that a dataset of this spec has."""
    if not spec["renderer"]:
        return ("simulation",)
    sensor = ("sensor",) if spec["recipe"]["sensor"]["enabled"] else ()
    return "simulation", "pixels", *sensor, *edits_of(spec)


def recipe_of(spec: Spec) -> Recipe:
    """The recipe of a spec.

    Raises:
        UsageError: a constant is unknown to this program, or has an impossible value.
        CorruptFile: a constant is of another kind than it should be.
    """
    try:
        return recipe_from_dict(spec["recipe"])
    except (TypeError, ValueError, AttributeError) as error:
        raise CorruptFile(f"{SPEC_FILE} holds no recipe ({error}); restore the original.") from None


def rendered_recipe_of(spec: Spec) -> Recipe:
    """The recipe of a spec with the cameras that its images are made with; raises as `recipe_of`."""
    return recipe_of({**spec, "recipe": {**spec["recipe"], **(spec["rig"] or {})}})


def _holds(fits: Callable[[Any], bool], value: Any) -> bool:
    try:
        return fits(value)
    except (TypeError, ValueError, KeyError):
        return False


def _is_number(value: Any, least: int = 0) -> bool:
    return type(value) is int and value >= least


def _has_views(values: Mapping[str, Any]) -> bool:
    return _is_number(values["views"], 1)


_FITS: dict[str, Callable[[Any], bool]] = {
    "recipe": lambda recipe: _is_number(recipe["frames"], 1) and _has_views(recipe),
    "seed": _is_number,
    "resolution": lambda size: size is None or (len(size) == 2 and all(_is_number(side, 1) for side in size)),
    "renderer": lambda renderer: renderer is None or type(renderer["name"]) is str,
    "rig": lambda rig: rig is None or _has_views(rig),
    "scenes_per_shard": lambda scenes: _is_number(scenes, 1),
    "splits": lambda splits: all(_is_number(splits[name]) for name in SPLITS),
    "edits": lambda edits: edits is None or set(edits) <= set(EDITS),
}
"""What reading a dataset relies on, key by key."""


def differences(old: Spec, new: Spec) -> list[str]:
    """The settings in which two specs differ, as `key: old -> new`; numbers of scenes do not count."""
    ignored = ("splits", "spec_hash")
    return _differences(
        {k: v for k, v in old.items() if k not in ignored}, {k: v for k, v in new.items() if k not in ignored}, ""
    )


def _differences(old: Any, new: Any, where: str) -> list[str]:
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [*old, *(key for key in new if key not in old)]
        return [line for key in keys for line in _differences(old.get(key), new.get(key), f"{where}.{key}".lstrip("."))]
    return [] if old == new else [f"{where}: {json.dumps(old)} -> {json.dumps(new)}"]
