"""Manifest of a run folder: commands, code, versions, datasets, models, and the hashes of its tables."""

import hashlib
import json
import math
import platform
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from benchmark.ranking.leaderboard import FILES
from benchmark.ranking.standings import ModelResult
from datagen.console.text import printable
from datagen.errors import CorruptFile
from datagen.storage.atomic import write_atomically
from datagen.storage.manifest import package_version
from datagen.storage.safe_io import read_json

MANIFEST = "manifest.json"
HASHED = tuple(name for name in FILES if name != "per_scene.csv")
"""Files that the manifest lists, without per_scene.csv, which is made from `scenes/` and too large for git."""
PACKAGES = ("obpose", "numpy", "scipy", "scikit-learn", "h5py", "torch")


def write_manifest(
    folder: Path, results: Sequence[ModelResult], hashed: Sequence[str] = HASHED, commands: Sequence[str] = ()
) -> None:
    """Write `manifest.json`, with the hashes of the files in `hashed`, which must exist, and the `commands` if any."""
    rows = [row for result in results for row in result.rows]
    facts = {
        **({"commands": [*commands]} if commands else {}),
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        "packages": {name: package_version(name) or "" for name in PACKAGES},
        "commits": sorted({row.commit for row in rows}),
        "models": _by_name((row.key.model, row.key.version) for row in rows),
        "tracks": _by_name(
            [*((r.key.track, r.key.track_spec) for r in rows), *((r.key.fit_track, r.key.fit_spec) for r in rows)]
        ),
        "rows": {"ok": sum(r.status == "ok" for r in rows), "failed": sum(r.status == "failed" for r in rows)},
        # Detects collapsed seeds; null if no floor was scored.
        "best_floor": _by_name(
            (r.row.key.track, None if math.isnan(r.best_floor) else round(r.best_floor, 6)) for r in results
        ),
        "sha256": {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in hashed},
    }
    write_atomically(folder / MANIFEST, (json.dumps(facts, indent=2) + "\n").encode())


def _by_name(pairs: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Map each name to its value, or to a sorted list if it has several; None comes last."""
    found: dict[str, set[Any]] = {}
    for name, value in pairs:
        found.setdefault(name, set()).add(value)
    ordered = {name: sorted(values, key=lambda value: (value is None, value)) for name, values in found.items()}
    return {name: values if len(values) > 1 else values[0] for name, values in ordered.items()}


def commands_of(folder: Path) -> list[str]:
    """Commands that made the rows of a run folder, oldest first, as its manifest lists them.

    Raises:
        CorruptFile: the manifest is damaged.
    """
    path = folder / MANIFEST
    if not path.is_file():
        return []
    advice = "Delete it: it is written again, but without the commands that made the results."
    try:
        facts = read_json(path)
    except CorruptFile as error:
        raise CorruptFile(f"{error} {advice}") from None
    commands = facts.get("commands", []) if isinstance(facts, dict) else None
    if not isinstance(commands, list) or not all(isinstance(command, str) for command in commands):
        raise CorruptFile(f"{path} is damaged: its commands are no list of texts. {advice}")
    return [*map(printable, commands)]
