"""Export a dataset: scenes one by one to a new folder in another format, with a card and Croissant metadata."""

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from datagen.console.progress import Progress, no_progress
from datagen.errors import DatagenError, UsageError
from datagen.formats.export_card import export_card
from datagen.formats.exporters import EXPORTERS, Format
from datagen.formats.exporters.interface import Exporter
from datagen.formats.scenes import ExportScene, scenes_of
from datagen.inspect.croissant import croissant
from datagen.inspect.dataset_card import description_of, license_of
from datagen.meshes.library import Library, open_library
from datagen.schema import GENERATOR, SPLITS
from datagen.storage.atomic import check_new_folder, new_folder, resolve_output, write_atomically
from datagen.storage.reader import Dataset
from datagen.storage.safe_io import read_json
from datagen.storage.spec import CARD_FILE, CROISSANT_FILE
from datagen.version import find_version

EXPORT_FILE = "export.json"
"""File that marks a folder as an export, and says of what."""


def export(
    source: Path,
    folder: Path,
    name: Format,
    *,
    splits: tuple[str, ...] = SPLITS,
    assets: Path | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> dict[str, int]:
    """Export a dataset to a new folder, which appears when it is complete; returns the numbers of scenes.

    Args:
        source: Folder of the dataset.
        folder: The new folder.
        name: Name of the format.
        splits: Splits to export; those without scenes are left out.
        assets: Folder of the dataset's meshes; only formats with models of the objects need it.
        overwrite: Replace an export in the same folder.
        progress: Shows the progress.

    Raises:
        UsageError: the folder is in use, the dataset does not have what the format needs, or its meshes are missing or
            have changed.
        DatagenError: the dataset is incomplete or damaged, or the folder cannot be written.
    """
    dataset, exporter = Dataset(source), EXPORTERS[name]
    counts = {split: dataset.splits[split] for split in SPLITS if split in splits and dataset.splits[split]}
    _check_request(dataset, exporter, counts, splits)
    _check_folder(source, folder, overwrite=overwrite)
    dataset.check_complete()
    library = open_library(dataset.spec.get("assets"), assets) if assets else None
    meshes = library.without_hulls() if library else None
    with new_folder(folder, replace=overwrite) as temporary, progress(sum(counts.values())) as advance:
        exporter.write(temporary, _counted(dataset, counts, meshes, advance))
        _write_metadata(temporary, dataset, exporter, name, counts)
    return counts


def _counted(
    dataset: Dataset, splits: Mapping[str, int], meshes: Library | None, advance: Callable[[], None]
) -> Iterator[ExportScene]:
    for split in splits:
        for scene in scenes_of(dataset.split(split), meshes):
            yield scene
            advance()


def _check_request(dataset: Dataset, exporter: Exporter, counts: Mapping[str, int], splits: tuple[str, ...]) -> None:
    if not counts:
        raise UsageError(f"{dataset.folder} has no scenes in {', '.join(splits)}; choose other --splits.")
    for split in counts:
        fields = dataset.split(split).fields()
        if missing := [field for field in exporter.needs if field not in fields]:
            whole = [name for name in counts if set(exporter.needs) <= set(dataset.split(name).fields())]
            remedy = f"Choose --splits {','.join(whole)}, or another --format." if whole else "Choose another --format."
            if "rgb" not in fields and "scene/description" in fields:
                remedy = f"Render it first: obpose-datagen render --from {dataset.folder}"
            raise UsageError(
                f"Format {exporter.title} needs {', '.join(missing)}, which the {split} scenes of {dataset.folder} do "
                f"not have. {remedy}"
            )


def _check_folder(source: Path, folder: Path, *, overwrite: bool) -> None:
    """Check that the new folder is free, or is an export that may be replaced.

    Raises:
        UsageError: it is neither, is a link that leads to itself, or one of the two folders lies in the other.
    """
    new, old = resolve_output(folder), source.resolve()
    if new.is_relative_to(old) or old.is_relative_to(new):
        raise UsageError(f"{folder} and the folder of the dataset, {source}, lie in each other; give another --out.")
    if not overwrite or not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        check_new_folder(folder)
    elif not is_export(folder):
        raise UsageError(
            f"{folder} holds something that obpose-datagen did not export; give another --out, nothing was changed."
        )


def is_export(folder: Path) -> bool:
    """Whether a folder is an export."""
    try:
        facts = read_json(folder / EXPORT_FILE)
    except (OSError, DatagenError):
        return False
    return isinstance(facts, dict) and facts.get("generator") == GENERATOR


def _write_metadata(folder: Path, dataset: Dataset, exporter: Exporter, name: Format, counts: dict[str, int]) -> None:
    spec = dataset.spec
    facts = {
        "generator": GENERATOR,
        "version": find_version(),
        "format": name,
        "scenes": counts,
        "dataset": {"recipe": spec["recipe"]["name"], "seed": spec["seed"], "spec_hash": spec["spec_hash"]},
    }
    metadata = croissant(
        name=f"{spec['recipe']['name']}-{name}",
        description=f"{description_of(spec)} Exported as {exporter.title}.",
        identity=spec["spec_hash"],
        license_url=license_of(spec).url,
        files=exporter.files,
        splits=counts,
    )
    texts = {
        EXPORT_FILE: json.dumps(facts, indent=2) + "\n",
        CROISSANT_FILE: metadata,
        CARD_FILE: export_card(spec, exporter, counts),
    }
    for file, text in texts.items():
        write_atomically(folder / file, text.encode())
