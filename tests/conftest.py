"""Shared by all tests: shape checks, and a small dataset made once a session."""

import dataclasses
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

from tests.paths import ROOT

UNCHECKED = {"datagen.render.kernels"}
"""Modules whose functions numba compiles; it cannot compile the checker's wrappers."""


def _leaf_modules() -> list[str]:
    files = (path for package in ("datagen", "obpose", "benchmark") for path in (ROOT / package).rglob("*.py"))
    with_shapes = (path for path in files if "jaxtyping" in path.read_text())
    names = {".".join(path.relative_to(ROOT).with_suffix("").parts) for path in with_shapes if path.stem != "__init__"}
    return sorted(names - UNCHECKED)


install_import_hook(_leaf_modules(), "beartype.beartype")

# Property tests draw the same examples in every run.
settings.register_profile("fixed", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("fixed")

# A shell starts what it puts in the background with Ctrl-C ignored, and programs under test would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files of the longest tests, judged by their timeouts, so that processes end together."""
    longest = Counter[Path]()
    for item in items:
        mark = item.get_closest_marker("timeout")
        longest[item.path] = max(longest[item.path], mark.args[0] if mark else 0)
    items.sort(key=lambda item: -longest[item.path])


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Turn the shape checks off, so that the program's own checks are reached."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="session")
def tiny_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of clips of the recipe `moving` with four frames, 4 train, 2 val, 2 test, at 64x64; not to be changed."""
    pytest.importorskip("pybullet", reason="simulation needs PyBullet")
    from datagen.config import load_recipe
    from datagen.pipeline.generate import generate

    folder = tmp_path_factory.mktemp("data") / "moving"
    recipe = dataclasses.replace(load_recipe("moving"), frames=4)
    generate(folder, recipe, splits={"train": 4, "val": 2, "test": 2}, resolution=(64, 64))
    return folder


@pytest.fixture(scope="module")
def local_cluster() -> Iterator[str]:
    """The address of a Dask cluster of one worker with four threads in this process.

    It ends with the module: its threads draw random numbers, which Hypothesis takes for an error of later tests.
    """
    distributed = pytest.importorskip("distributed")
    place = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "worker_dashboard_address": "127.0.0.1:0"}
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=4, processes=False, protocol="tcp://", **place
    ) as cluster:
        yield cluster.scheduler_address
