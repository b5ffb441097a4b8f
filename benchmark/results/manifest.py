"""Manifest of a run folder: code, versions, datasets, models, and the hashes of its tables."""

import hashlib
import json
import math
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmark.ranking.leaderboard import FILES
from benchmark.ranking.standings import Entry
from datagen.storage.atomic import write_atomically

MANIFEST = "manifest.json"
HASHED = tuple(name for name in FILES if name != "per_scene.csv")
"""Files that the manifest lists. per_scene.csv is made from `scenes/` and too large for git, so clones lack it."""
PACKAGES = ("obpose", "numpy", "scipy", "scikit-learn", "h5py", "torch")


def write_manifest(folder: Path, entries: Sequence[Entry], hashed: Sequence[str] = HASHED) -> None:
    """Write `manifest.json`, with the hashes of the files in `hashed`, which must exist."""
    rows = [row for entry in entries for row in entry.rows]
    facts = {
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "packages": {name: _version(name) for name in PACKAGES},
        "commits": sorted({row.commit for row in rows}),
        "models": {row.key.model: row.key.version for row in rows},
        "tracks": {row.key.track: row.key.track_spec for row in rows} | {r.key.fit_track: r.key.fit_spec for r in rows},
        "rows": {"ok": sum(r.status == "ok" for r in rows), "failed": sum(r.status == "failed" for r in rows)},
        "best_floor": {entry.row.key.track: _number(entry.best_floor) for entry in entries},
        "sha256": {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in hashed},
    }
    write_atomically(folder / MANIFEST, (json.dumps(facts, indent=2) + "\n").encode())


def _number(value: float) -> float | None:
    """MSC-FG of the best floor, which detects collapsed seeds; null if no floor was scored."""
    return None if math.isnan(value) else round(value, 6)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
