"""Facts about a finished dataset, `manifest.json`; all but `run` and `versions` follow from the shards."""

import hashlib
from collections import Counter
from collections.abc import Iterable
from contextlib import closing
from importlib import metadata
from pathlib import Path
from typing import Any

from datagen.errors import CorruptFile
from datagen.schema import SPLITS
from datagen.storage.safe_io import read_json
from datagen.storage.shard import Shard
from datagen.storage.spec import MANIFEST_FILE, Spec, shard_ranges

_PACKAGES = ("obpose", "numpy", "h5py", "numba", "pybullet", "pyrender", "mitsuba")


def make_manifest(folder: Path, spec: Spec, *, seconds: float, workers: int, scenes_made: int) -> dict[str, Any]:
    """Gather the facts about a complete dataset, and about the run that completed it."""
    splits = {name: _split_facts(folder, spec, name) for name in SPLITS}
    return {
        "spec_hash": spec["spec_hash"],
        "content_hash": _joint_hash(facts["content_hash"] for facts in splits.values()),
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
        manifest = read_json(path)
    except FileNotFoundError:
        return None
    if not isinstance(manifest, dict):
        raise CorruptFile(f"{path} is damaged: it holds {manifest!r:.20}, expected an object.")
    return manifest


def _split_facts(folder: Path, spec: Spec, split: str) -> dict[str, Any]:
    numbers = range(len(shard_ranges(spec["splits"][split], spec["scenes_per_shard"])))
    shards = [_shard_facts(folder, spec, split, number) for number in numbers]
    rejections = sum((shard.pop("rejections") for shard in shards), Counter[str]())
    return {
        "scenes": sum(shard["scenes"] for shard in shards),
        "attempts": sum(shard.pop("attempts") for shard in shards),
        "rejections": dict(sorted(rejections.items())),
        "bytes": sum(shard["bytes"] for shard in shards),
        "content_hash": _joint_hash(shard["content_hash"] for shard in shards),
        "shards": shards,
    }


def _shard_facts(folder: Path, spec: Spec, split: str, number: int) -> dict[str, Any]:
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
