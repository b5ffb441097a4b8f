"""All scenes of a dataset, and the folder as a whole."""

import dataclasses
import hashlib
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import joblib
from rich.console import Console
from rich.progress import track

from datagen import schema
from datagen.errors import EXIT_OK, EXIT_VERIFICATION, CorruptFile, DatagenError
from datagen.manifest import make_manifest, read_manifest
from datagen.shard import Shard
from datagen.spec import MANIFEST_FILE, Spec, shard_name, shard_ranges
from datagen.storage import Dataset
from datagen.verify.finding import Finding
from datagen.verify.record import verify_record

SCENES_PER_JOB = 8

MOST_PRINTED = 200


@dataclass(frozen=True)
class Checked:
    """What came out of some scenes."""

    findings: list[Finding]
    contents: dict[str, str]
    """SHA-256 of each scene's description, by the scene's name."""


def run(folder: str | Path, *, workers: int = 1) -> int:
    """Check a dataset, print what is wrong with it, and give the exit code that says so.

    Raises:
        UsageError: the folder holds no dataset of this format.
    """
    console = Console(soft_wrap=True, highlight=False)
    findings = find(folder, workers=workers)
    for finding in findings[:MOST_PRINTED]:
        console.print(str(finding), markup=False)
    if len(findings) > MOST_PRINTED:
        console.print(f"... and {len(findings) - MOST_PRINTED} more.")
    if findings:
        scenes = {(finding.split, finding.scene) for finding in findings if finding.scene is not None}
        console.print(f"{folder}: {len(findings)} findings in {len(scenes)} scenes.", markup=False)
        return EXIT_VERIFICATION
    console.print(f"{folder}: {sum(Dataset(folder).splits.values())} scenes verified, no finding.", markup=False)
    return EXIT_OK


def find(folder: str | Path, *, workers: int = 1) -> list[Finding]:
    """All findings of a dataset, in the order of its scenes.

    Raises:
        UsageError: the folder holds no dataset of this format.
    """
    try:
        dataset = Dataset(folder)
    except CorruptFile as error:
        return [Finding("file", str(error))]
    jobs = [
        (split, range(start, min(start + SCENES_PER_JOB, size)))
        for split, size in dataset.splits.items()
        for start in range(0, size, SCENES_PER_JOB)
    ]
    parallel = joblib.Parallel(n_jobs=workers, return_as="generator")
    results = parallel(joblib.delayed(_check_scenes)(dataset, *job) for job in jobs)
    shown = track(results, "Verifying", total=len(jobs), transient=True, disable=not Console().is_terminal)
    checked = [part for part in shown if part is not None]
    scenes = [finding for part in checked for finding in part.findings]
    whole = [] if scenes else [*_check_attributes(dataset), *_check_manifest(dataset)]
    return [*scenes, *_duplicates(checked), *whole]


def _check_scenes(dataset: Dataset, split: str, scenes: range) -> Checked:
    findings, contents = [], {}
    for scene in scenes:
        place = {"split": split, "scene": scene, "shard": shard_name(split, scene // dataset.spec["scenes_per_shard"])}
        try:
            record = dataset.split(split)[scene]
            stored = dataset.split(split).hash(scene)
        except (DatagenError, OSError, RuntimeError, KeyError, ValueError) as error:
            findings.append(Finding("file", f"cannot be read: {error}", **place))
            continue
        if schema.scene_hash(record) != stored:
            findings.append(Finding("hash", f"the arrays' SHA-256 is not the stored {stored[:16]}...", **place))
        found = verify_record(record, groups(dataset.spec))
        findings.extend(dataclasses.replace(finding, **place) for finding in found)
        if "scene/description" in record:
            text = bytes(record["scene/description"].item())
            contents[f"{split} scene {scene}"] = hashlib.sha256(text).hexdigest()
    return Checked(findings, contents)


def groups(spec: Spec) -> tuple[str, ...]:
    """Groups of fields that a dataset of this spec must have."""
    if spec["resolution"] is None:
        return ("simulation",)
    return ("simulation", "pixels", "sensor") if spec["recipe"]["sensor"]["enabled"] else ("simulation", "pixels")


def _check_attributes(dataset: Dataset) -> Iterator[Finding]:
    """What the shards, which can be read, say about themselves."""
    for split, size in dataset.splits.items():
        for number, scenes in enumerate(shard_ranges(size, dataset.spec["scenes_per_shard"])):
            with closing(Shard(dataset.split(split).path(number))) as shard:
                stored = shard.attributes
            expected = {"depth_scale": schema.DEPTH_SCALE, "split": split, "first_scene": scenes.start}
            for name, value in {**expected, "data_version": dataset.spec["data_version"]}.items():
                if stored.get(name) != value:
                    message = f"attribute {name} is {stored.get(name)}, expected {value}"
                    yield Finding("file", message, split=split, shard=shard_name(split, number))


def _check_manifest(dataset: Dataset) -> Iterator[Finding]:
    """The record of the finished dataset is that of its files, which can be read."""
    try:
        manifest = read_manifest(dataset.folder)
    except ValueError as error:
        yield Finding("file", f"{MANIFEST_FILE} is damaged: {error}")
        return
    if manifest is None:
        yield Finding("file", f"{MANIFEST_FILE} is missing: the dataset was never completed")
    else:
        fresh = make_manifest(dataset.folder, dataset.spec, seconds=0.0, workers=0, scenes_made=0)
        if wrong := [key for key in ("spec_hash", "content_hash", "splits") if manifest.get(key) != fresh[key]]:
            yield Finding("file", f"{MANIFEST_FILE} does not fit the files: {', '.join(wrong)}")


def _duplicates(checked: list[Checked]) -> Iterator[Finding]:
    first: dict[str, str] = {}
    for part in checked:
        for name, content in part.contents.items():
            if content in first:
                yield Finding("duplicate", f"{name} is the same scene as {first[content]}")
            first.setdefault(content, name)
