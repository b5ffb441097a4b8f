import dataclasses
from pathlib import Path

import numpy as np
import pytest

from benchmark.models.interface import Prediction
from benchmark.results.labels import write_labels
from benchmark.studies.claims.shadows_cli import compare, in_shadow, main
from datagen.errors import EXIT_USAGE
from datagen.pipeline.generate import generate
from datagen.storage.reader import Dataset
from tests.worlds import generated

TRUTH = np.array([[[[0, 0, 0, 1], [0, 0, 2, 2]]]])
SHADOW = np.array([[[[0, 1, 1, 1], [0, 0, 0, 0]]]], dtype=bool)
NOTHING_UNSEEN = np.zeros(TRUTH.shape, dtype=bool)


def test_perfect_labels_have_no_errors_and_shadows_are_of_the_background():
    found = compare(TRUTH, TRUTH + 1, 1, SHADOW, NOTHING_UNSEEN)
    assert (found.background, found.shadow, found.leaked, found.missed) == (5, 2, 0, 0)
    assert found.ari == found.ari_without_shadows == 1


def test_an_object_that_takes_its_shadow_is_wrong_there_alone():
    labels = TRUTH.copy()
    labels[0, 0, 0, 2], labels[0, 0, 1, 2] = 1, 0
    found = compare(TRUTH, labels, 0, SHADOW, NOTHING_UNSEEN)
    assert (found.leaked, found.leaked_in_shadow, found.missed) == (1, 1, 1)
    labels[0, 0, 1, 2] = 2
    found = compare(TRUTH, labels, 0, SHADOW, NOTHING_UNSEEN)
    assert found.ari < found.ari_without_shadows == 1


def test_pixels_without_depth_never_count():
    labels = np.where(SHADOW, 3, TRUTH)
    found = compare(TRUTH, labels, 0, SHADOW, unseen=SHADOW)
    assert (found.background, found.shadow, found.leaked, found.missed) == (3, 0, 0, 0)
    assert found.ari == found.ari_without_shadows == 1


def test_rounding_makes_no_shadow():
    image = np.full((2, 3), 100, dtype=np.uint8)
    assert not in_shadow(image, image + 1).any()
    assert in_shadow(image, image + 2).all()


@pytest.fixture(scope="module")
def datasets(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The same two scenes with and without shadows."""
    folder = tmp_path_factory.mktemp("shadows")
    recipe = generated.recipe()
    for name, shadows in (("with", True), ("without", False)):
        lit = dataclasses.replace(recipe, lighting=dataclasses.replace(recipe.lighting, shadows=shadows))
        generate(folder / name, lit, splits={"test": 2}, seed=0, resolution=generated.RESOLUTION)
    return folder / "with", folder / "without"


def predict(path: Path, data: Path, *, everything: bool = False) -> Path:
    """True labels, or those of one object that is everywhere."""
    with write_labels(path, 2, data) as writer:
        for index, record in enumerate(Dataset(data).split("test")):
            labels = record["segmentation"].astype(np.int64)
            writer.put(index, Prediction(np.ones_like(labels) if everything else labels, 0))
    return path


def test_shadows_are_found_in_real_scenes(
    tmp_path: Path, datasets: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
):
    shaded, plain = datasets
    assert main([str(predict(tmp_path / "true.h5", shaded)), "--without", str(plain)]) == 0
    said = capsys.readouterr().out
    assert "Wrong between background and objects: 0 pixels" in said
    share = float(said.partition("scenes; ")[2].partition("%")[0])
    assert 0.5 < share < 20
    assert main([str(predict(tmp_path / "all.h5", shaded, everything=True)), "--without", str(plain)]) == 0
    assert f"{share:.1f}% of the leaked" in capsys.readouterr().out


def test_other_scenes_are_refused(tmp_path: Path, datasets: tuple[Path, Path], capsys: pytest.CaptureFixture[str]):
    shaded, _ = datasets
    generated.make(tmp_path / "other", {"test": 2}, seed=7)
    labels = predict(tmp_path / "true.h5", shaded)
    assert main([str(labels), "--without", str(tmp_path / "other")]) == EXIT_USAGE
    assert "expected the same but for shadows" in capsys.readouterr().err
    generated.make(tmp_path / "fewer", {"test": 0, "val": 1})
    assert main([str(labels), "--without", str(tmp_path / "fewer")]) == EXIT_USAGE
