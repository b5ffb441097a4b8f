"""Run folders with scores that a test chooses, as the harness would write them."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.metrics import CLIP_METRICS, METRICS
from benchmark.results.run_folder import Measured, RunKey, RunRow, SceneTable, save_row, save_scenes

SPEC = "5bec" * 16

HOSTILE = "a|b`c`\n## x <script>alert(1)</script> [x](http://y) [/bold]*z*_~~w~~ & \\ \x1b[31m\u202e \udcff"
"""A name or message that would be markup, a command or a control sequence if it were printed unescaped."""


def run_row(model: str = "m", track: str = "moving", seed: int = 0, **changes: Any) -> RunRow:
    """A finished run of a model that learns, on three scenes; `changes` are other fields of row and key."""
    key = {"fit_track": track, "version": 1, "config_hash": "c0", "fit_spec": SPEC, "track_spec": SPEC}
    key |= {name: changes.pop(name) for name in list(changes) if name in key}
    fields: dict[str, Any] = {
        "status": "ok",
        "reason": "",
        "config": {"reach": 0.02},
        "tuned": False,
        "uses_labels": False,
        "kind": "learned",
        "priors": ("slots",),
        "random": True,
        "n_scenes": 3,
        "parameters": 1000,
        "device": "cpu",
        "commit": "abc",
        "measured": Measured(0.01 * (seed + 1), 5.0, 100.0 + seed),
    }
    return RunRow(RunKey(track=track, model=model, seed=seed, **key), **fields | changes)


def failed_row(model: str = "m", track: str = "moving", seed: int = 0, **changes: Any) -> RunRow:
    """A run that gave no scores, with the facts that are known before a model runs."""
    facts: dict[str, Any] = {
        "status": "failed",
        "reason": "out of memory",
        "config": {},
        "n_scenes": 0,
        "parameters": 0,
        "measured": Measured(math.nan, math.nan, math.nan),
    }
    return run_row(model, track, seed, **facts | changes)


def scene_table(scores: Mapping[str, Sequence[float] | np.ndarray], frames: int = 2) -> SceneTable:
    """Scores of each scene by metric; those not given are 0.9, and nan stands for a scene that leaves one undefined."""
    n = len(next(iter(scores.values())))
    table: SceneTable = {"scene": np.arange(n, dtype=np.float64), "n_frames": np.full(n, float(frames))}
    for name in (*METRICS, *CLIP_METRICS):
        values = np.asarray(scores.get(name, np.full(n, 0.9)), np.float64)
        count = frames if name in METRICS else 1
        table |= {name: values, f"{name}_n": np.where(np.isnan(values), 0.0, count)}
    counts = {"objects": 2.5, "one_object": 0, "undefined": 0, "identity_switches": 1, "ignored": 7}
    return table | {name: np.full(n, float(value)) for name, value in counts.items()}


def save_run(folder: Path, row: RunRow, table: SceneTable | None = None) -> None:
    """Write a run as finished."""
    if table is not None:
        columns = {name: values.tolist() for name, values in table.items()}
        lines = [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
        save_scenes(folder, row.key.name, lines)
    save_row(folder, row)
