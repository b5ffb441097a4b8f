"""Small datasets that exporters write, and one call to export them."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from datagen.formats.export import export
from datagen.formats.exporters import Format
from datagen.formats.scenes import ExportScene
from datagen.scene import Camera
from datagen.storage.reader import Dataset
from tests.worlds import rendered

Export = Callable[..., Path]


@pytest.fixture(scope="session")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two training clips of three frames and one camera; the second has two objects."""
    scenes = [rendered.scene(), rendered.scene(rendered.STANDING[:2])]
    return rendered.write_dataset(tmp_path_factory.mktemp("export") / "clips", [rendered.record(s) for s in scenes])


@pytest.fixture(scope="session")
def stills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One still scene from two cameras, 64x48."""
    record = rendered.record(rendered.scene(frames=1, views=2), resolution=(64, 48))
    return rendered.write_dataset(tmp_path_factory.mktemp("export") / "stills", [record])


@pytest.fixture(scope="session")
def clevr(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of a scene from two of ObSuRF's cameras, 320x240."""
    angle = 2 * np.arctan(16 / 35)
    cameras = tuple(
        Camera((float(0.75 * np.cos(a)), float(0.75 * np.sin(a)), 0.7), (0.0, 0.0, 0.0), float(angle), 4 / 3)
        for a in (0.0, 2.0)
    )
    scene = dataclasses.replace(rendered.scene(frames=2, table=0.9), cameras=cameras)
    record = rendered.record(scene, resolution=(320, 240))
    return rendered.write_dataset(tmp_path_factory.mktemp("export") / "clevr", [record])


@pytest.fixture
def exported(tmp_path: Path) -> Export:
    """Function that exports a dataset and gives the new folder."""

    def run(dataset: Path, name: Format) -> Path:
        export(dataset, tmp_path / name, name)
        return tmp_path / name

    return run


def source(dataset: Path, index: int = 0) -> ExportScene:
    """A training scene as stored."""
    return ExportScene(Dataset(dataset).split("train"), index)
