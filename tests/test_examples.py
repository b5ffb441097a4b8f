"""The scripts in examples/ run as their docstrings say."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.paths import ROOT

EXAMPLES = ROOT / "examples"


def run(name: str, *arguments: object) -> str:
    """Output of a script that ends well."""
    done = subprocess.run(
        [sys.executable, EXAMPLES / name, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("pybullet", reason="simulation needs PyBullet")
    folder = tmp_path_factory.mktemp("examples") / "data"
    said = run("1_dataset.py", folder)
    assert "6 training scenes" in said
    assert "Object 2" in said
    return folder


@pytest.mark.slow
def test_a_model_is_trained_and_segments(dataset: Path, tmp_path: Path):
    said = run("2_train_and_segment.py", dataset, tmp_path / "run", "--steps", 2)
    assert "ARI-FG" in said
    assert (tmp_path / "run" / "model.safetensors").exists()


@pytest.mark.slow
def test_a_model_of_ones_own_is_compared_with_others(dataset: Path, tmp_path: Path):
    run("3_own_model.py", dataset, tmp_path)
    leaderboard = (tmp_path / "run" / "leaderboard.csv").read_text()
    assert "depth-bands" in leaderboard
    assert "plane-dbscan" in leaderboard


@pytest.mark.slow
def test_every_example_is_run_here():
    assert {path.name for path in EXAMPLES.glob("*.py")} == {"1_dataset.py", "2_train_and_segment.py", "3_own_model.py"}
