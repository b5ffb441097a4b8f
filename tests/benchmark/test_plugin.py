"""The model of docs/benchmark.md, as it is printed there."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from benchmark.ranking.standings import pooled
from benchmark.results.run_folder import load_runs, load_scenes
from tests.paths import ROOT
from tests.worlds.traced import write_dataset

PAGE = ROOT / "docs" / "benchmark.md"


def blocks(language: str) -> list[str]:
    """Code blocks of the page."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)


def test_a_model_takes_at_most_fifteen_lines():
    model = blocks("python")[0]
    assert 0 < len([line for line in model.splitlines() if line.strip()]) <= 15


def test_the_page_s_package_is_complete():
    project = tomllib.loads(blocks("toml")[0])["project"]
    assert project["entry-points"]["obpose.models"] == {"depth-bands": "depth_bands:DepthBands"}


@pytest.mark.slow
def test_a_package_that_pip_installs_is_found_and_scored(tmp_path: Path):
    source, site = tmp_path / "source", tmp_path / "site"
    source.mkdir()
    (source / "depth_bands.py").write_text(blocks("python")[0])
    (source / "pyproject.toml").write_text(blocks("toml")[0])
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target"]
    subprocess.run([*pip, site, source], check=True, capture_output=True, text=True)
    data = write_dataset(tmp_path / "data", scenes=2, frames=2)
    command = ["--model", "depth-bands", "--data", data, "--out", tmp_path / "out", "--seeds", 1]
    result = subprocess.run(
        [sys.executable, "-m", "benchmark.commands.cli", *map(str, command)],
        env={**os.environ, "PYTHONPATH": f"{ROOT}:{site}"},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr
    (row,) = load_runs(tmp_path / "out")
    assert (row.key.model, row.status, row.key.version) == ("depth-bands", "ok", 1)
    assert pooled(load_scenes(tmp_path / "out", row), "miou_bg") > 0.5
