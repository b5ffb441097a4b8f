import json
from pathlib import Path

import numpy as np

from benchmark.ranking.manifest import write_manifest
from benchmark.ranking.standings import standings
from benchmark.results.run_folder import RunRow
from tests.chosen_scores import run_row, scene_table

ON_A, ON_B, ON_C = ({"track_spec": name, "fit_spec": name} for name in "abc")


def facts(folder: Path, *runs: tuple[RunRow, float]) -> dict[str, object]:
    """Models, tracks and floors of the manifest of runs with these MSC-FG."""
    tables = [scene_table({"msc_fg": np.full(3, score)}) for _, score in runs]
    write_manifest(folder, standings([row for row, _ in runs], tables), ())
    manifest = json.loads((folder / "manifest.json").read_text())
    return {name: manifest[name] for name in ("models", "tracks", "best_floor")}


def test_one_dataset_and_version_of_a_name_are_plain_values(tmp_path: Path):
    runs = [(run_row("m", seed=seed, fit_track="mixed", track_spec="a", fit_spec="b"), 0.5) for seed in range(2)]
    assert facts(tmp_path, *runs) == {
        "models": {"m": 1},
        "tracks": {"moving": "a", "mixed": "b"},
        "best_floor": {"moving": None},
    }


def test_several_datasets_and_versions_of_a_name_are_sorted_lists(tmp_path: Path):
    floors = [
        (run_row("floor", kind="floor", **ON_B), 0.1),
        (run_row("floor", kind="floor", version=10, **ON_A), 0.2),
        (run_row("m", **ON_C), 0.5),
    ]
    assert facts(tmp_path, *floors) == {
        "models": {"floor": [1, 10], "m": 1},
        "tracks": {"moving": ["a", "b", "c"]},
        "best_floor": {"moving": [0.1, 0.2, None]},
    }
