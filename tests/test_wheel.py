"""The wheel holds all it needs: it works where the checkout cannot be seen."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.paths import ROOT

PARTS = ("datagen", "obpose", "benchmark", "assets", "pyproject.toml", "README.md", "LICENSE")


def run(*command: object, **options) -> str:
    done = subprocess.run([str(part) for part in command], text=True, capture_output=True, check=False, **options)
    assert done.returncode == 0, f"{command} ended with {done.returncode}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """A folder with the installed wheel, built from a copy so that the checkout stays clean."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for name in PARTS:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name)
    run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, source)
    (wheel,) = folder.glob("*.whl")
    run(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", folder / "site", wheel)
    return folder / "site"


@pytest.mark.slow
def test_the_wheel_generates_and_scores_outside_the_checkout(site, tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(site)}
    where = (
        "import datagen, obpose, benchmark, assets; print(*(m.__file__ for m in (datagen, obpose, benchmark, assets)))"
    )
    for file in run(sys.executable, "-c", where, cwd=tmp_path, env=environment).split():
        assert Path(file).is_relative_to(site)
    datagen = (sys.executable, site / "bin" / "obpose-datagen")
    run(*datagen, "--scenes", 10, "--video", "--resolution", "32x32", "--out", "d", cwd=tmp_path, env=environment)
    run(*datagen, "verify", "d", cwd=tmp_path, env=environment)
    bench = (sys.executable, site / "bin" / "obpose-bench")
    run(*bench, "--model", "plane-dbscan", "--data", "d", cwd=tmp_path, env=environment)
    assert "plane-dbscan" in (tmp_path / "results" / "leaderboard.csv").read_text()
    assert (tmp_path / "results" / "report.html").exists()
    run(*bench, "selftest", cwd=tmp_path, env=environment)


@pytest.mark.slow
def test_the_wheel_carries_every_recipe_and_the_licence(site):
    recipes = {path.name for path in (ROOT / "assets" / "recipes").glob("*.toml")}
    assert {path.name for path in (site / "assets" / "recipes").glob("*.toml")} == recipes
    assert list(site.glob("obpose-*.dist-info/licenses/LICENSE"))
