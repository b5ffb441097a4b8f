from pathlib import Path

import numpy as np
import pytest

from benchmark.clips import ClipSequence
from benchmark.models.interface import Prediction
from benchmark.results.labels import write_labels
from benchmark.studies.claims.neighbours_cli import images_of, main, objects_adjoin
from datagen.storage.reader import Dataset
from tests.worlds import generated
from tests.worlds.traced import write_dataset


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("neighbours") / "data"
    generated.make(folder, {"test": 4})
    return folder


@pytest.mark.parametrize("turns", range(4))
def test_objects_adjoin_along_either_axis_and_not_across_a_corner(turns: int):
    beside, corner = np.array([[0, 1, 2], [0, 0, 0]]), np.array([[0, 1, 0], [0, 0, 2]])
    assert objects_adjoin(np.rot90(beside, turns))
    assert not objects_adjoin(np.rot90(corner, turns))
    assert not objects_adjoin(np.array([[0, 1, 1], [0, 0, 1]]))


def test_every_image_with_several_objects_counts_in_one_of_the_two_kinds(
    tmp_path: Path, data: Path, capsys: pytest.CaptureFixture[str]
):
    truths = [record["segmentation"] for record in Dataset(data).split("test")]
    images = [image for truth in truths for image in truth.reshape(-1, *truth.shape[2:])]
    with write_labels(tmp_path / "one.h5", len(truths), data) as writer:
        for index, truth in enumerate(truths):
            # All objects in one slot: ARI-FG is 0 wherever there are several.
            writer.put(index, Prediction((truth > 0).astype(np.int64), 0))
    adjoin, scores = images_of(tmp_path / "one.h5", data)
    several = [image for image in images if len(np.unique(image[image > 0])) > 1]
    assert adjoin.tolist() == [objects_adjoin(image) for image in several]
    assert (scores[:, 0] == 0).all()
    assert main([str(tmp_path / "one.h5")]) == 0
    assert "one.h5: 0.000 / " in capsys.readouterr().out


def test_pixels_without_depth_do_not_count(tmp_path: Path):
    noisy = write_dataset(tmp_path / "noisy", scenes=2, spheres=3, sensor=True)
    scenes = Dataset(noisy).split("test")
    clips = ClipSequence(scenes)
    with write_labels(tmp_path / "mine.h5", len(scenes), noisy) as writer:
        for index, record in enumerate(scenes):
            assert not clips[index].valid[record["segmentation"] > 0].all()
            writer.put(index, Prediction(np.where(clips[index].valid, record["segmentation"], 9), 0))
    _, scores = images_of(tmp_path / "mine.h5", noisy)
    assert len(scores)
    assert (scores == 1).all()


def test_a_missing_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main([str(tmp_path / "none.h5")]) != 0
    assert "none.h5" in capsys.readouterr().err
