"""What a run folder was made of: code, versions, datasets, models, and the hashes of its tables."""

import hashlib
import json
import platform
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmark.files import write_whole
from benchmark.results import RunRow

MANIFEST = "manifest.json"
PACKAGES = ("obpose", "numpy", "scipy", "scikit-learn", "h5py", "torch")


def write_manifest(folder: Path, rows: Sequence[RunRow], tables: Iterable[str]) -> None:
    """Write `manifest.json`; `tables` are names of files in the folder."""
    facts = {
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "packages": {name: _version(name) for name in PACKAGES},
        "commits": sorted({row.commit for row in rows}),
        "models": {row.key.model: row.key.version for row in rows},
        "tracks": {row.key.track: row.key.track_spec for row in rows} | {r.key.fit_track: r.key.fit_spec for r in rows},
        "rows": {"ok": sum(r.status == "ok" for r in rows), "failed": sum(r.status == "failed" for r in rows)},
        "sha256": {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in tables},
    }
    write_whole(folder / MANIFEST, (json.dumps(facts, indent=2) + "\n").encode())


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
