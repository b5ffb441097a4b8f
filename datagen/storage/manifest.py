"""Facts about a finished dataset, `manifest.json`; all but `run` and `versions` follow from the shards."""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing, suppress
from importlib import metadata
from pathlib import Path
from typing import Any

from datagen.errors import CorruptFile
from datagen.schema import SPLITS
from datagen.storage.dataset_folder import write_file
from datagen.storage.safe_io import MOST_TEXT_BYTES, read_json
from datagen.storage.shard import Shard
from datagen.storage.spec import MANIFEST_FILE, Spec, settings_hash, shard_name, shard_ranges

Facts = dict[str, list[dict[str, Any]]]
"""Facts about each shard of each split."""

_LISTED = ("file", "scenes", "bytes", "sha256", "content_hash")
"""Facts about a shard that the manifest lists; the others are summed."""
_KINDS = {**dict.fromkeys(_LISTED, str), "scenes": int, "bytes": int, "attempts": int, "rejections": dict}
"""Types of the facts about a shard."""
_PACKAGES = ("obpose", "numpy", "h5py", "numba", "pybullet", "pyrender", "mitsuba")


def make_manifest(spec: Spec, facts: Facts, *, seconds: float, workers: int, scenes_made: int) -> dict[str, Any]:
    """Merge the facts about the shards of a complete dataset, and about the run that completed it."""
    splits = {name: _split_facts(shards) for name, shards in facts.items()}
    return {
        "spec_hash": spec["spec_hash"],
        "content_hash": _joint_hash(merged["content_hash"] for merged in splits.values()),
        "splits": splits,
        "versions": {name: package_version(name) for name in _PACKAGES},
        "run": {"seconds": round(seconds, 3), "workers": workers, "scenes_made": scenes_made},
    }


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """The manifest of a dataset, None where no run has finished.

    Raises:
        CorruptFile: the file is damaged.
    """
    path = folder / MANIFEST_FILE
    try:
        manifest = read_json(path, most_bytes=MOST_TEXT_BYTES)
    except FileNotFoundError:
        return None
    if not isinstance(manifest, dict):
        raise CorruptFile(f"{path} is damaged: it holds {manifest!r:.20}, expected an object.")
    return manifest


def is_finished(folder: Path, spec: Spec) -> bool:
    """Whether a run has finished the dataset with these numbers of scenes, and all shards are there."""
    with suppress(CorruptFile):
        return _has_all_shards(folder, spec) and (read_manifest(folder) or {}).get("spec_hash") == spec["spec_hash"]
    return False


def file_facts(folder: Path, spec: Spec) -> Facts:
    """Read and hash every shard of a complete dataset."""
    return {split: [shard_facts(folder, spec, split, number) for number in _numbers(spec, split)] for split in SPLITS}


def recorded_facts(folder: Path, spec: Spec) -> Facts | None:
    """Facts about the shards, from the records that were written beside them; None while scenes are missing.

    A shard without a record that fits is read and hashed, once no scene is missing.
    """
    if not _has_all_shards(folder, spec):
        return None
    places = {
        (split, number): len(scenes)
        for split in SPLITS
        for number, scenes in enumerate(shard_ranges(spec["splits"][split], spec["scenes_per_shard"]))
    }
    records = {place: _record(folder, spec, *place) for place in places}
    if any(record["scenes"] < places[place] for place, record in records.items() if record):
        return None
    # Of shards without records, which a finished run has left, the last of a split may be too short for a longer one.
    unrecorded = [place for place, record in records.items() if not record]
    for place in (*dict(unrecorded).items(), *unrecorded):
        if _length(folder, spec, *place) < places[place]:
            return None
    facts: Facts = {split: [] for split in SPLITS}
    for place, record in records.items():
        facts[place[0]].append(record or shard_facts(folder, spec, *place))
    return facts


def _length(folder: Path, spec: Spec, split: str, number: int) -> int:
    with closing(Shard(folder, spec, split, number)) as shard:
        return len(shard)


def _record(folder: Path, spec: Spec, split: str, number: int) -> dict[str, Any] | None:
    """The record of a shard, if it is about the present file."""
    path = folder / record_name(split, number)
    with suppress(CorruptFile, OSError):
        record = read_json(path)
        size = path.with_suffix(".h5").stat().st_size
        expected = settings_hash(spec), shard_name(split, number), size
        if _is_record(record) and (record.get("settings_hash"), record["file"], record["bytes"]) == expected:
            return record
    return None


def _is_record(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and all(type(value.get(key)) is kind for key, kind in _KINDS.items())
        and all(type(count) is int for count in value["rejections"].values())
    )


def write_record(folder: Path, spec: Spec, split: str, number: int) -> None:
    """Hash a new shard and write its record, so that no later process has to."""
    settings = settings_hash(spec)
    record = {"settings_hash": settings, **shard_facts(folder, spec, split, number)}
    write_file(folder, record_name(split, number), json.dumps(record).encode(), settings)


def delete_records(folder: Path) -> None:
    """Delete the records of all shards, once they are merged into the manifest."""
    for split in SPLITS:
        for path in folder.glob(f"{split}-*.json"):
            if path.stem.removeprefix(f"{split}-").isdecimal():
                path.unlink(missing_ok=True)


def record_name(split: str, number: int) -> str:
    """File name of a shard's record."""
    return shard_name(split, number).replace(".h5", ".json")


def _has_all_shards(folder: Path, spec: Spec) -> bool:
    there = set(os.listdir(folder))
    return all(shard_name(split, number) in there for split in SPLITS for number in _numbers(spec, split))


def _numbers(spec: Spec, split: str) -> range:
    return range(len(shard_ranges(spec["splits"][split], spec["scenes_per_shard"])))


def _split_facts(shards: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    return {
        "scenes": sum(shard["scenes"] for shard in shards),
        "attempts": sum(shard["attempts"] for shard in shards),
        "rejections": dict(sorted(sum((Counter(shard["rejections"]) for shard in shards), Counter[str]()).items())),
        "bytes": sum(shard["bytes"] for shard in shards),
        "content_hash": _joint_hash(shard["content_hash"] for shard in shards),
        "shards": [{key: shard[key] for key in _LISTED} for shard in shards],
    }


def shard_facts(folder: Path, spec: Spec, split: str, number: int) -> dict[str, Any]:
    """Read and hash a shard."""
    with closing(Shard(folder, spec, split, number)) as shard:
        path = shard.path
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        return {
            "file": path.name,
            "scenes": len(shard),
            "bytes": path.stat().st_size,
            "sha256": digest,
            "content_hash": _joint_hash(shard.hashes()),
            **_sampling_facts(shard),
        }


def _sampling_facts(shard: Shard) -> dict[str, Any]:
    """Number of samples that were drawn and rejected; imported scenes were not sampled."""
    if "scene/attempts" not in shard.fields:
        return {"attempts": len(shard), "rejections": Counter[str]()}
    return {
        "attempts": int(shard.column("scene/attempts").sum()),
        "rejections": sum((shard.rejections(row) for row in range(len(shard))), Counter[str]()),
    }


def _joint_hash(hashes: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(hashes).encode()).hexdigest()


def package_version(package: str) -> str | None:
    """Version of an installed package; None if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
