"""Verify all scenes of a dataset, and the folder as a whole."""

import dataclasses
import functools
import hashlib
import random
import re
from collections.abc import Collection, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from datagen import schema
from datagen.console.progress import tracked
from datagen.console.text import counted
from datagen.errors import EXIT_OK, EXIT_VERIFICATION, CorruptFile, DatagenError, UsageError
from datagen.meshes.library import Library, open_library
from datagen.pipeline.parallel import make_all
from datagen.storage.manifest import Facts, make_manifest, read_manifest, shard_facts
from datagen.storage.reader import Dataset, Split
from datagen.storage.shard import Shard
from datagen.storage.spec import MANIFEST_FILE, groups_of, recipe_of, rendered_recipe_of, shard_name, shard_ranges
from datagen.verify.cameras import check_cameras
from datagen.verify.imported import verify_imported
from datagen.verify.scene_case import Finding
from datagen.verify.scene_checks import verify_record

SCENES_PER_JOB = 8

MOST_PRINTED = 200

SHARD = re.compile(rf"({'|'.join(schema.SPLITS)})-\d{{5,}}\.h5")

UNREADABLE = (DatagenError, OSError, RuntimeError, KeyError, TypeError, ValueError)
"""Exceptions that damaged files cause, including h5py's."""


@dataclass(frozen=True)
class Checked:
    """Result of checking some scenes."""

    findings: list[Finding]
    contents: dict[str, str]
    """SHA-256 of each scene's description, by the scene's name."""


def run(folder: str | Path, *, workers: int = 1, assets: Path | None = None, sample: int | None = None) -> int:
    """Check a dataset, print the findings, and return the exit code; see `find` for the arguments.

    Raises:
        UsageError: the folder holds no dataset of this format and data version.
    """
    console = Console(soft_wrap=True, highlight=False)
    findings = find(folder, workers=workers, assets=assets, sample=sample)
    for finding in findings[:MOST_PRINTED]:
        console.print(str(finding), markup=False)
    if len(findings) > MOST_PRINTED:
        console.print(f"... and {len(findings) - MOST_PRINTED} more.")
    if findings:
        scenes = {(finding.split, finding.scene) for finding in findings if finding.scene is not None}
        console.print(
            f"{folder}: {counted(len(findings), 'finding')} in {counted(len(scenes), 'scene')}.", markup=False
        )
        return EXIT_VERIFICATION
    total = sum(Dataset(folder).splits.values())
    checked = f"{min(sample, total)} of {total}" if sample else str(total)
    console.print(f"{folder}: {checked} scenes verified, no finding.", markup=False)
    if Dataset(folder).imported:
        console.print(
            "Imported: files, hashes, cameras, counts and boxes agree; whether depth and masks are right is unknown."
        )
    return EXIT_OK


def find(
    folder: str | Path, *, workers: int = 1, assets: Path | None = None, sample: int | None = None
) -> list[Finding]:
    """All findings of a dataset, in the order of its scenes.

    Args:
        folder: The dataset.
        workers: Number of processes.
        assets: Folder of the dataset's meshes.
        sample: Number of scenes to check, drawn at random, with their shards; None for all.

    Raises:
        UsageError: the folder holds no dataset of this format and data version.
    """
    try:
        dataset = Dataset(folder)
    except CorruptFile as error:
        return [Finding("file", str(error))]
    if dataset.spec["data_version"] != schema.DATA_VERSION:
        raise UsageError(
            f"{folder} has data version {dataset.spec['data_version']}, this program proves {schema.DATA_VERSION}; "
            f"use the version of the program that made it, see {MANIFEST_FILE}."
        )
    meshes = open_library(dataset.spec.get("assets"), assets)
    meshes = meshes and meshes.without_hulls()
    jobs = list(_sampled(dataset, sample) if sample else _all_scenes(dataset))
    shards = dict.fromkeys((split, scenes[0] // dataset.spec["scenes_per_shard"]) for split, scenes in jobs)
    with closing(make_all(functools.partial(_check_scenes, dataset, meshes), jobs, workers)) as results:
        checked = list(tracked(results, "verified jobs", len(jobs)))
    scenes = [finding for part in checked for finding in part.findings]
    faults = [Finding("assets", message) for message in (meshes.faults() if meshes else ())]
    return [*faults, *scenes, *_duplicates(checked), *_check_files(dataset, shards), *_check_manifest(dataset, shards)]


def _all_scenes(dataset: Dataset) -> Iterator[tuple[str, range]]:
    for split, size in dataset.splits.items():
        for start in range(0, size, SCENES_PER_JOB):
            yield split, range(start, min(start + SCENES_PER_JOB, size))


def _sampled(dataset: Dataset, sample: int) -> Iterator[tuple[str, range]]:
    """Draw scenes of all splits without repetition; the same ones each time."""
    total, first = sum(dataset.splits.values()), 0
    numbers = sorted(random.Random(0).sample(range(total), min(sample, total)))
    for split, size in dataset.splits.items():
        for number in numbers:
            if first <= number < first + size:
                yield split, range(number - first, number - first + 1)
        first += size


def _check_scenes(dataset: Dataset, meshes: Library | None, split: str, scenes: range) -> Checked:
    findings, contents = [], {}
    records = Split(dataset.folder, dataset.spec, split)
    recipe = None if dataset.imported else recipe_of(dataset.spec)
    for scene in scenes:
        place = {"split": split, "scene": scene, "shard": shard_name(split, scene // dataset.spec["scenes_per_shard"])}
        try:
            record, stored = records[scene], records.hash(scene)
        except UNREADABLE as error:
            findings.append(Finding("file", f"cannot be read: {error}", **place))
            continue
        # Stored hash, then content.
        if schema.scene_hash(record) != stored:
            findings.append(Finding("hash", f"the arrays' SHA-256 is not the stored {stored[:16]}...", **place))
        if recipe is None:
            found = list(verify_imported(record, dataset.fields(split)))
        else:
            found = verify_record(
                record,
                groups_of(dataset.spec),
                recipe.for_scene(scene).physics,
                sensor=recipe.sensor,
                renderer=(dataset.spec["renderer"] or {"name": "raster"})["name"],
                meshes=meshes,
            )
            if not found:
                rendered = rendered_recipe_of(dataset.spec).for_scene(scene)
                found = list(check_cameras(record, rendered, dataset.spec.get("cameras", ())))
        findings.extend(dataclasses.replace(finding, **place) for finding in found)
        # Hashes of contents, to find scenes that occur twice.
        if "scene/description" in record:
            text = bytes(record["scene/description"].item())
            contents[f"{split} scene {scene}"] = hashlib.sha256(text).hexdigest()
    return Checked(findings, contents)


def _check_files(dataset: Dataset, shards: Collection[tuple[str, int]]) -> Iterator[Finding]:
    """Check that these shards hold the expected scenes, and that there are all shards and no others."""
    expected, there = set(), {path.name for path in dataset.folder.iterdir() if SHARD.fullmatch(path.name)}
    for split, size in dataset.splits.items():
        for number, scenes in enumerate(shard_ranges(size, dataset.spec["scenes_per_shard"])):
            name = shard_name(split, number)
            expected.add(name)
            for message in _wrong_about(dataset, split, number, scenes) if (split, number) in shards else ():
                yield Finding("file", message, split=split, shard=name)
            if (split, number) not in shards and name not in there:
                yield Finding("file", "is missing", split=split, shard=name)
    for name in sorted(there - expected):
        split = name.partition("-")[0]
        message = f"is there, but {split} has no more than {dataset.splits[split]} scenes"
        yield Finding("file", message, split=split, shard=name)


def _wrong_about(dataset: Dataset, split: str, number: int, scenes: range) -> Iterator[str]:
    try:
        with closing(Shard(dataset.folder, dataset.spec, split, number)) as shard:
            there = len(shard)
    except UNREADABLE:
        return  # Its scenes have been reported.
    if there > len(scenes):
        yield f"holds {there} scenes, expected {len(scenes)}"


def _check_manifest(dataset: Dataset, shards: Collection[tuple[str, int]]) -> Iterator[Finding]:
    """Check that the manifest matches these shards; what it says of all together, only where these are all."""
    try:
        manifest = read_manifest(dataset.folder)
    except (DatagenError, OSError) as error:
        yield Finding("file", f"{MANIFEST_FILE} cannot be read: {error}")
        return
    if manifest is None:
        yield Finding("file", f"{MANIFEST_FILE} is missing: the dataset was never completed")
        return
    # Expected manifest from the files; totals only if all shards are there.
    try:
        wrong = [] if manifest.get("spec_hash") == dataset.spec["spec_hash"] else ["spec_hash"]
        facts: Facts = {split: [] for split in schema.SPLITS}
        for split, number in shards:
            facts[split].append(shard_facts(dataset.folder, dataset.spec, split, number))
        fresh = make_manifest(dataset.spec, facts, seconds=0.0, workers=0, scenes_made=0)
        if sum(facts["scenes"] for facts in fresh["splits"].values()) == sum(dataset.splits.values()):
            wrong += [key for key in ("content_hash", "splits") if manifest.get(key) != fresh[key]]
        else:
            listed = [shard for split in schema.SPLITS for shard in manifest["splits"][split]["shards"]]
            names = {shard["file"]: shard for shard in listed}
            new = [shard for split in schema.SPLITS for shard in fresh["splits"][split]["shards"]]
            wrong += [shard["file"] for shard in new if names.get(shard["file"]) != shard]
    except UNREADABLE as error:
        yield Finding("file", f"{MANIFEST_FILE} cannot be compared with the files: {error}")
        return
    if wrong:
        yield Finding("file", f"{MANIFEST_FILE} does not fit the files: {', '.join(wrong)}")


def _duplicates(checked: list[Checked]) -> Iterator[Finding]:
    first: dict[str, str] = {}
    for part in checked:
        for name, content in part.contents.items():
            if content in first:
                yield Finding("duplicate", f"{name} is the same scene as {first[content]}")
            first.setdefault(content, name)
