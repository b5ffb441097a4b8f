"""Spec of a dataset: the content of its `dataset.json`, fixed before any scene is made.

The spec is a plain dict:
    format_version, data_version, generator
    recipe .......... every constant of the recipe; its `resolution` is only the default of the one below
    seed
    resolution ...... width and height of the images, null if there are none
    renderer ........ name and version, of a path tracer also engine and samples; null if there are no images
    rig ............. cameras that replace the recipe's when rendering (`rig`, `views`), usually null
    cameras ......... views of a cameras file that replace the rig's; key missing if there is none
    edits ........... counterfactual edits, in the order of `schema.EDITS`; key missing if there are none
    assets .......... meshes, see `datagen.meshes.library.MeshEntry`; key missing if there are none
    with ............ optional signals, in the order of `schema.SIGNALS`; key missing if there are none
    scenes_per_shard
    splits .......... number of scenes of each split
    import .......... format, source and options of an imported dataset; key missing otherwise
    fields .......... for each split, the fields that an imported dataset has; key missing otherwise
    compression ..... lz4; key missing if images are compressed with gzip
    spec_hash ....... SHA-256 of all the above: the dataset's identity
"""

import hashlib
import json
import math
import os
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from datagen.config import Recipe, recipe_from_dict
from datagen.errors import CorruptFile, UsageError
from datagen.schema import (
    DATA_VERSION,
    EDITS,
    FIELDS,
    FORMAT_VERSION,
    GENERATOR,
    IMPORTER,
    SIGNALS,
    SPLITS,
    EditKind,
    Signal,
)
from datagen.storage.safe_io import MOST_ARRAY_BYTES, parse_json, read_json

SPEC_FILE = "dataset.json"
MANIFEST_FILE = "manifest.json"
CARD_FILE = "README.md"
CROISSANT_FILE = "croissant.json"

MOST_SCENES = 1_000_000
"""Largest number of scenes of a split."""

_MOST_SCENES_PER_SHARD = 64
_MOST_BYTES_PER_SHARD = 2**30
MOST_PIXELS = MOST_ARRAY_BYTES // 3
"""Largest number of pixels of a scene: its colours are read as one array."""
_BYTES_PER_PIXEL = 9  # rgb, depth, segmentation, sensor depth and validity
_BYTES_PER_EDITED_PIXEL = 7  # rgb, depth, segmentation, effects
BYTES_PER_SIGNAL_PIXEL = {"flow": 10, "normals": 6, "coordinates": 6}
"""Bytes that each signal stores for a pixel; tracks and amodal masks do not grow with the pixels."""

_LONGEST_NAME = 1000
_MEND = "Restore it, or delete it and run the command that made the dataset again, which rebuilds it from the shards."

Spec = dict[str, Any]
Compression = Literal["gzip", "lz4"]
"""Compression of the images of a dataset."""


def make_spec(
    recipe: Mapping[str, Any],
    *,
    seed: int,
    splits: Mapping[str, int],
    resolution: tuple[int, int] | None,
    renderer: Mapping[str, Any] | None,
    rig: Mapping[str, Any] | None = None,
    edits: Collection[EditKind] = (),
    assets: Sequence[Mapping[str, Any]] = (),
    signals: Collection[Signal] = (),
    cameras: Sequence[Mapping[str, Any]] = (),
    compression: Compression = "gzip",
) -> Spec:
    """Build the spec of a dataset; `recipe` and `rig` are nested plain values."""
    pixels = _pixels(recipe, rig, resolution)
    signal_bytes = sum(BYTES_PER_SIGNAL_PIXEL.get(name, 0) for name in signals)
    scene_bytes = pixels * (_BYTES_PER_PIXEL + len(edits) * _BYTES_PER_EDITED_PIXEL + signal_bytes)
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
    if assets:
        spec["assets"] = list(assets)
    if cameras:
        spec["cameras"] = list(cameras)
    if signals:
        spec["with"] = [name for name in SIGNALS if name in signals]
    if compression != "gzip":
        spec["compression"] = compression
    return _signed(spec)


def make_imported_spec(
    origin: Mapping[str, Any],
    facts: Mapping[str, Any],
    *,
    splits: Mapping[str, int],
    resolution: tuple[int, int],
    fields: Mapping[str, Collection[str]],
) -> Spec:
    """Build the spec of an imported dataset.

    Args:
        origin: Format, source and options of the import, plain values.
        facts: The constants of a recipe that readers of all datasets rely on, see `_is_recipe`.
        splits: Scenes of each split.
        resolution: Width and height of the images.
        fields: Names of the fields of each split; others are unknown.
    """
    made = make_spec(facts, seed=0, splits=splits, resolution=resolution, renderer=None)
    named = {split: [name for name in FIELDS if name in fields.get(split, ())] for split in SPLITS}
    made = {key: value for key, value in made.items() if key != "spec_hash"}
    return _signed({**made, "generator": IMPORTER, "import": origin, "fields": named})


def _signed(values: Mapping[str, Any]) -> Spec:
    spec = json.loads(json.dumps(values))
    return {**spec, "spec_hash": _digest(spec)}


def _pixels(recipe: Mapping[str, Any], rig: Mapping[str, Any] | None, resolution: Sequence[int] | None) -> int:
    """Number of pixels of all images of a scene."""
    return recipe["frames"] * (rig or recipe)["views"] * math.prod(resolution or (0, 0))


def with_splits(spec: Spec, splits: Mapping[str, int]) -> Spec:
    """Copy of a spec with other numbers of scenes."""
    changed = {key: value for key, value in spec.items() if key != "spec_hash"}
    changed["splits"] = {name: int(splits.get(name, 0)) for name in SPLITS}
    return {**changed, "spec_hash": _digest(changed)}


def spec_text(spec: Spec) -> str:
    """Text of `dataset.json` for a spec."""
    return json.dumps(spec, indent=2, allow_nan=False) + "\n"


def settings_hash(spec: Spec) -> str:
    """SHA-256 of all settings of scenes and their storage, which excludes the numbers of scenes."""
    return _digest({key: value for key, value in spec.items() if key not in ("splits", "spec_hash")})


def _digest(values: Mapping[str, Any]) -> str:
    text = json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def split_sizes(scenes: int) -> dict[str, int]:
    """Split N scenes 80/10/10: of every ten, the second goes to test, the third to val, the others to train.

    No size shrinks as N grows, so that a dataset can be extended: 1 -> 1/0/0, 2 -> 1/0/1, 3 -> 1/1/1, 10 -> 8/1/1.
    """
    test, val = (scenes + 8) // 10, (scenes + 7) // 10
    return {"train": scenes - val - test, "val": val, "test": test}


def shard_name(split: str, number: int) -> str:
    """File name of a split's shard."""
    return f"{split}-{number:05d}.h5"


def shard_numbers(folder: Path, split: str) -> list[int]:
    """Sorted numbers of the shards of a split in a folder; empty if the folder does not exist."""
    names = {*os.listdir(folder)} if folder.is_dir() else set[str]()
    matches = (re.fullmatch(rf"{split}-(\d{{5,18}})\.h5", name) for name in names)
    numbers = sorted({int(match[1]) for match in matches if match})
    return [number for number in numbers if shard_name(split, number) in names]


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
        spec = read_json(path)
    except (FileNotFoundError, NotADirectoryError):
        raise UsageError(f"{folder} holds no dataset: {_missing_spec(folder)}") from None
    except CorruptFile as error:
        raise CorruptFile(f"{error} {_MEND}") from None
    if not isinstance(spec, dict) or spec.get("generator") not in (GENERATOR, IMPORTER):
        raise UsageError(f"{path} was not written by {GENERATOR}; give a folder made by it.")
    if spec.get("format_version") != FORMAT_VERSION:
        found = f"{spec.get('format_version')!r:.20}"
        raise UsageError(f"{path} has format version {found}, this program reads {FORMAT_VERSION}; update the program.")
    if spec.get("spec_hash") != _digest({key: value for key, value in spec.items() if key != "spec_hash"}):
        raise CorruptFile(f"{path} was changed after it was written: its spec_hash does not fit. {_MEND}")
    if wrong := [key for key, fits in _FITS.items() if not _holds(fits, spec.get(key))]:
        raise CorruptFile(f"{path} is no spec: {', '.join(wrong)} missing or malformed. {_MEND}")
    if any((spec.get(key) is not None) != is_imported(spec) for key in ("import", "fields")):
        raise CorruptFile(f"{path} is no spec: its generator does not fit its keys. {_MEND}")
    if _pixels(spec["recipe"], spec["rig"], spec["resolution"]) > MOST_PIXELS:
        raise CorruptFile(f"{path} is no spec: its scenes have more than {MOST_PIXELS:,} pixels. {_MEND}")
    return spec


def _missing_spec(folder: Path) -> str:
    if shards := [shard_name(split, number) for split in SPLITS for number in shard_numbers(folder, split)]:
        return (
            f"{SPEC_FILE} is missing beside {', '.join(shards[:3])}{', ...' * (len(shards) > 3)}. Run the command that "
            "made these shards again, which rebuilds it from them."
        )
    return f"it has no {SPEC_FILE}; give a folder made by {GENERATOR}."


def edits_of(spec: Spec) -> tuple[EditKind, ...]:
    """The counterfactual edits of a dataset, in the order of `schema.EDITS`."""
    return tuple(kind for kind in EDITS if kind in spec.get("edits", ()))


def signals_of(spec: Spec) -> tuple[Signal, ...]:
    """The optional signals of a dataset, in the order of `schema.SIGNALS`."""
    return tuple(name for name in SIGNALS if name in spec.get("with", ()))


def compression_of(spec: Spec) -> Compression:
    """The compression of the images of a dataset."""
    return "lz4" if "compression" in spec else "gzip"


def views_of(spec: Spec) -> int:
    """Number of cameras of a dataset: that of the rig used for rendering, otherwise that of its recipe."""
    return (spec["rig"] or spec["recipe"])["views"]


def has_moving_cameras(spec: Spec) -> bool:
    """Whether the cameras of a dataset have a pose for each frame."""
    if cameras := spec.get("cameras"):
        return any(len(view["poses"]) > 1 for view in cameras)
    rig = (spec["rig"] or spec["recipe"]).get("rig", {})  # imported datasets have none
    return spec["recipe"]["frames"] > 1 and rig.get("motion", "still") != "still"


def lengths_of(spec: Spec) -> dict[str, int]:
    """Lengths of the axes of `schema.FIELDS` that a spec determines."""
    width, height = spec["resolution"] or (0, 0)
    images = {"width": width, "height": height} if spec["resolution"] else {}
    return {"frame": spec["recipe"]["frames"], "view": views_of(spec), **images}


def is_imported(spec: Spec) -> bool:
    """Whether the scenes come from another project, so that there is no recipe and only some fields are known."""
    return spec.get("generator") == IMPORTER


def fields_of(spec: Spec, split: str) -> tuple[str, ...]:
    """Names of the fields that the scenes of a split have."""
    if is_imported(spec):
        return tuple(spec["fields"][split])
    return tuple(name for name, field in FIELDS.items() if field.group in groups_of(spec))


def groups_of(spec: Spec) -> tuple[str, ...]:
    """Complete groups of fields in a dataset of this spec; an imported one has none, see `fields_of`."""
    if is_imported(spec):
        return ()
    moving = ("moving_camera",) if has_moving_cameras(spec) else ()
    if not spec["renderer"]:
        return "simulation", *moving
    sensor = ("sensor",) if spec["recipe"]["sensor"]["enabled"] else ()
    return "simulation", *moving, "pixels", *sensor, *edits_of(spec), *signals_of(spec)


@lru_cache(maxsize=2)
def _parsed_recipe(text: str) -> Recipe:
    """Recipe of a JSON text; every scene requests that of its dataset."""
    return recipe_from_dict(parse_json(text))


def recipe_of(spec: Spec) -> Recipe:
    """The recipe of a spec.

    Raises:
        UsageError: a constant is unknown to this program, or has an impossible value.
        CorruptFile: a constant has the wrong type.
    """
    check_generated(spec)
    try:
        return _parsed_recipe(json.dumps(spec["recipe"]))
    except UsageError as error:
        raise UsageError(f"{SPEC_FILE} holds a recipe that this version does not take: {error}") from None
    except ValueError as error:
        raise CorruptFile(f"{SPEC_FILE} holds no recipe ({error}); restore the original.") from None


def check_generated(spec: Spec) -> None:
    """Check that a dataset was generated, for features that need the scenes themselves.

    Raises:
        UsageError: it was imported.
    """
    if is_imported(spec):
        raise UsageError(
            f"The dataset was imported (format {spec['import']['format']}): it has images, but no recipe, shapes and "
            "motions, so that it cannot be rendered, generated again or extended. Use a dataset that "
            f"{GENERATOR} generated, or import into another folder."
        )


def rendered_recipe_of(spec: Spec) -> Recipe:
    """Recipe of a spec, with the cameras used for its images; raises the same errors as `recipe_of`."""
    return recipe_of({**spec, "recipe": {**spec["recipe"], **(spec["rig"] or {})}})


def _holds(fits: Callable[[Any], bool], value: Any) -> bool:
    try:
        return fits(value)
    except (TypeError, ValueError, KeyError, AttributeError, ArithmeticError):
        return False


def _is_number(value: Any, least: int = 0, most: int | float = math.inf) -> bool:
    return type(value) is int and least <= value <= most


def _is_name(value: Any) -> bool:
    return type(value) is str and len(value) <= _LONGEST_NAME and value.isprintable()


def _is_size(value: Any) -> bool:
    return type(value) is list and len(value) == 2 and all(_is_number(side, 1, MOST_PIXELS) for side in value)


def _has_views(values: Mapping[str, Any]) -> bool:
    return _is_number(values["views"], 1, MOST_PIXELS)


def _is_asset(asset: Mapping[str, Any]) -> bool:
    texts = ("name", "file", "sha256", "up", "hulls_method", "hulls_sha256")
    return all(_is_name(asset[key]) for key in texts) and set(asset["splits"]) <= set(SPLITS)


def _is_camera(view: Mapping[str, Any]) -> bool:
    numbers = [view[name] for name in ("fx", "fy", "cx", "cy")] + [x for pose in view["poses"] for x in pose]
    return (
        _is_size([view["width"], view["height"]])
        and all(type(number) in (int, float) for number in numbers)
        and len(view["poses"]) > 0
        and all(len(pose) == 7 for pose in view["poses"])
    )


def _is_recipe(recipe: Mapping[str, Any]) -> bool:
    return (
        all(_is_name(name) for name in (recipe["name"], recipe["description"], *recipe["parts"]))
        and _is_number(recipe["frames"], 1, MOST_PIXELS)
        and _has_views(recipe)
        and _is_size(recipe["resolution"])
        and 0.001 <= recipe["fps"] <= 1e6
        and _is_number(recipe["objects"]["maximum"], 0, 255)
        and type(recipe.get("rig", {})) is dict
        and type(recipe["sensor"]["enabled"]) is bool
    )


_FITS: dict[str, Callable[[Any], bool]] = {
    "data_version": lambda version: _is_number(version, 1),
    "recipe": _is_recipe,
    "seed": _is_number,
    "resolution": lambda size: size is None or _is_size(size),
    "renderer": lambda renderer: (
        renderer is None
        or (
            _is_name(renderer["name"]) and _is_number(renderer["version"]) and _is_number(renderer.get("samples", 1), 1)
        )
    ),
    "rig": lambda rig: rig is None or (_has_views(rig) and type(rig["rig"]) is dict),
    "scenes_per_shard": lambda scenes: _is_number(scenes, 1, MOST_SCENES),
    "splits": lambda splits: all(_is_number(splits[name], 0, MOST_SCENES) for name in SPLITS),
    "import": lambda origin: origin is None or (_is_name(origin["format"]) and _is_name(origin["source"])),
    "fields": lambda fields: fields is None or all(set(fields[split]) <= set(FIELDS) for split in SPLITS),
    "assets": lambda assets: assets is None or (type(assets) is list and all(_is_asset(asset) for asset in assets)),
    "edits": lambda edits: edits is None or (type(edits) is list and set(edits) <= set(EDITS)),
    "cameras": lambda views: views is None or all(_is_camera(view) for view in views),
    "with": lambda names: names is None or (type(names) is list and set(names) <= set(SIGNALS)),
    "compression": lambda name: name in (None, "lz4"),
}
"""Check of each key of a spec that readers rely on."""


def differences(old: Spec, new: Spec) -> list[str]:
    """Settings in which two specs differ, as `key: old -> new`; ignores the numbers of scenes."""
    ignored = ("splits", "spec_hash")
    return _differences(
        {k: v for k, v in old.items() if k not in ignored}, {k: v for k, v in new.items() if k not in ignored}, ""
    )


def _differences(old: Any, new: Any, where: str) -> list[str]:
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [*old, *(key for key in new if key not in old)]
        return [line for key in keys for line in _differences(old.get(key), new.get(key), f"{where}.{key}".lstrip("."))]
    if old == new:
        return []
    if (names := _names(old)) != (others := _names(new)):
        old, new = names, others
    return [f"{where}: {json.dumps(old):.100} -> {json.dumps(new):.100}"]


def _names(value: Any) -> Any:
    """Names of the entries of a list, such as that of the meshes; other values as they are."""
    named = isinstance(value, list) and all(isinstance(one, dict) and "name" in one for one in value)
    return [one["name"] for one in value] if named else value
