"""A dataset's card: the README.md in its folder, with the header that the Hugging Face hub reads."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from datagen.inspect import imported
from datagen.inspect.croissant import Files, croissant
from datagen.inspect.stats import Summary, readable, summary
from datagen.schema import FIELDS
from datagen.storage.dataset_folder import write_file
from datagen.storage.reader import Dataset
from datagen.storage.safe_io import parse_json
from datagen.storage.shard import CONVENTIONS
from datagen.storage.spec import CARD_FILE, CROISSANT_FILE, Spec, is_imported, settings_hash

SIZES = [(10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**7, "1M<n<10M")]
"""The hub's words for numbers of images below a limit."""


def write_card(folder: str | Path) -> Path:
    """Write DIR/README.md and DIR/croissant.json of a complete dataset, and give the path of the former.

    Raises:
        DatagenError: the folder holds no complete dataset.
    """
    spec = Dataset(folder).spec
    figures = summary(folder)
    text = imported.card(spec, readable(figures)) if is_imported(spec) else card(spec, figures, meshes_seen(folder))
    texts = {CROISSANT_FILE: metadata(spec), CARD_FILE: text}
    for name, text in texts.items():
        write_file(Path(folder), name, text.encode(), settings_hash(spec))
    return Path(folder) / CARD_FILE


def metadata(spec: Spec) -> str:
    """Croissant metadata of a dataset."""
    shards = Files("*.h5", "application/x-hdf5", "Shards of up to 64 scenes; every array has its scenes first.")
    return croissant(
        name=spec["recipe"]["name"],
        description=description_of(spec),
        identity=spec["spec_hash"],
        license_url=license_of(spec).url,
        files={"shards": shards},
        splits=spec["splits"],
    )


@dataclass(frozen=True)
class License:
    """Licence of a dataset, as the Hugging Face hub and Croissant name it."""

    hub: str
    url: str | None


def license_of(spec: Spec) -> License:
    """Licence of a dataset; that of imported images is unknown."""
    return License("other", None) if spec.get("import") else License("mit", "https://opensource.org/license/mit")


def description_of(spec: Spec) -> str:
    """One sentence about the content of a dataset."""
    return spec["recipe"]["description"] or "An own recipe."


def card(spec: Spec, figures: Summary, seen: Mapping[str, Collection[str]] | None = None) -> str:
    """The text of the card; `seen` are the content hashes of the meshes that each split's scenes hold."""
    rendered = f"rendered with `{figures['renderer']}`" if figures["renderer"] else "simulated, without images"
    fields = '["rgb", "depth", "segmentation"]' if figures["resolution"] else '["poses/position"]'
    renderer = spec["renderer"] and f"{spec['renderer']['name']} {spec['renderer']['version']}"
    split = next(name for name, scenes in spec["splits"].items() if scenes)
    meshes = " --assets path/to/the/meshes" if spec.get("assets") else ""
    return f"""---
license: {license_of(spec).hub}
task_categories:
- image-segmentation
- depth-estimation
size_categories:
- {size_category(figures["images"])}
tags:
- object-centric-learning
- synthetic
- rgb-d
pretty_name: obpose {figures["recipe"]}
---

# {figures["recipe"]}

{description_of(spec)} Made with `{spec["generator"]}`, {rendered}; every constant of the \
recipe is in `dataset.json`.

{_table(figures)}
{_meshes(spec, seen or {})}## Loading

```python
from datagen.storage.reader import Dataset

scenes = Dataset("path/to/this/folder").split("{split}")
record = scenes[0]  # every array of a scene, by name
part = scenes.read(0, {fields}, frames=slice(0, 1))
```

The files are plain HDF5 (`h5py.File("{split}-00000.h5")["objects/size"][0]`); `obpose.data.datasets.SceneDataset` is a
PyTorch dataset over the folder.

## Conventions

{CONVENTIONS}

## Identity

| | |
|---|---|
| spec hash | `{spec["spec_hash"]}` |
| recipe, seed | {spec["recipe"]["name"]}, {spec["seed"]} |
| data version, format version | {spec["data_version"]}, {spec["format_version"]} |
| renderer and version | {renderer or "-"} |

The hash of every scene's arrays is stored beside it. The first command proves arrays, hashes and geometry; the second
makes a scene again and compares.

```sh
obpose-datagen verify path/to/this/folder{meshes}
obpose-datagen regenerate path/to/this/folder --split {split} --scene 0{meshes}
```
"""


def meshes_seen(folder: str | Path) -> dict[str, set[str]]:
    """Content hashes of the meshes in the scenes of each split, from the stored objects."""
    dataset, seen = Dataset(folder), {}
    if not dataset.spec.get("assets"):
        return {}
    for split, scenes in dataset.splits.items():
        reader, found = dataset.split(split), set[str]()
        for index in range(scenes):
            record = reader.read(index, ["objects/count", "objects/parameters"])
            for text in record["objects/parameters"][: int(record["objects/count"])]:
                shape = parse_json(bytes(text).decode())
                if shape["family"] == "mesh":
                    found.add(shape["parameters"]["sha256"])
        seen[split] = found
    return seen


def _meshes(spec: Spec, seen: Mapping[str, Collection[str]]) -> str:
    """Section about the meshes; it states which of the test split's shapes occur in training."""
    if not (assets := spec.get("assets")):
        return ""
    rows = [
        f"| {asset['name']} | `{asset['file']}` | {asset['scale']:g} | {', '.join(asset['splits'])} "
        f"| {asset['hulls']} ({asset['hulls_method']}) | `{asset['sha256']}` |"
        for asset in assets
    ]
    train, test = set(seen.get("train", ())), set(seen.get("test", ()))
    counts = ", ".join(f"{len(hashes)} in {split}" for split, hashes in seen.items())
    if not (train and test):
        proof = ""
    elif train & test:
        proof = f" {len(train & test)} of the test split's {len(test)} shapes also occur in training."
    else:
        proof = " No shape of the test split occurs in training: their content hashes are disjoint."
    return "\n".join(
        [
            "## Meshes",
            "",
            f"The scenes hold {len(set().union(*seen.values()))} different meshes: {counts}.{proof}",
            "The meshes themselves are not part of the dataset; their licences are those of their sources.",
            "",
            "| mesh | file | metres per unit | splits | hulls | SHA-256 of content |",
            "|---|---|---|---|---|---|",
            *rows,
            "",
            "",
        ]
    )


def size_category(images: int) -> str:
    """Size category of the Hugging Face hub for a number of images."""
    return next((name for limit, name in SIZES if images < limit), "n>10M")


def _table(figures: Summary) -> str:
    scenes = ", ".join(f"{number} {split}" for split, number in figures["scenes"].items())
    rows = [
        ("scenes", scenes),
        ("frames x views a scene", f"{figures['frames_per_scene']} x {figures['views']}"),
        ("resolution (width x height)", "x".join(map(str, figures["resolution"] or ())) or "-"),
        ("objects a scene", _counts(figures["objects_per_scene"])),
        ("categories", _counts(figures["categories"])),
        ("motions", _counts(figures["motions"])),
        ("objects that move", _percent(figures["moving_objects"])),
        ("clips with a collision", _percent(figures["colliding_clips"])),
        ("frames in which objects touch (gap under 5 mm)", _percent(figures["touching_frames"])),
        ("rejected samples", _shares(figures["rejected"])),
        ("bytes an image on disk", f"{figures['bytes_per_image']:.0f}"),
        *_pixel_rows(figures),
    ]
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows), ""])


def _pixel_rows(figures: Summary) -> list[tuple[str, str]]:
    if "foreground" not in figures:
        return []
    near, far = figures["depth_range"]
    quantiles = ", ".join(
        f"{100 * float(q):.0f} %: {value:.2f}" for q, value in figures["visible_fraction_quantiles"].items()
    )
    return [
        ("foreground share (mean)", _shares(figures["foreground"])),
        ("visible fraction of objects (quantiles)", quantiles),
        ("objects less than half visible", _percent(figures["objects_less_than_half_visible"])),
        ("depth", f"{near:.2f} to {far:.2f} m"),
    ]


def _counts(histogram: dict[str, int]) -> str:
    return ", ".join(f"{name}: {number}" for name, number in histogram.items()) or "-"


def _shares(shares: dict[str, float]) -> str:
    return ", ".join(f"{name}: {_percent(share)}" for name, share in shares.items()) or "none"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def field_table() -> str:
    """The format's table of fields, as it stands in `docs/dataset.md`."""
    head = ["| field | type | axes | unit | frame | group | what |", "|---|---|---|---|---|---|---|"]
    rows = [
        f"| `{field.name}` | {'text' if field.dtype == 'S' else field.dtype} | {' '.join(field.axes) or '-'} "
        f"| {field.unit} | {field.frame} | {field.group} | {field.description or '-'} |"
        for field in FIELDS.values()
    ]
    return "\n".join([*head, *rows])
