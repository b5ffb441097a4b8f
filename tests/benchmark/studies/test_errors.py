from pathlib import Path

import numpy as np
import pytest

from benchmark.clips import ClipSequence
from benchmark.models.interface import Prediction
from benchmark.report.observations import read_truth
from benchmark.results.labels import write_labels
from benchmark.studies.__main__ import main
from benchmark.studies.errors import objects_adjoin, scores_by_adjoining
from datagen.errors import EXIT_OK
from datagen.storage.reader import Dataset
from tests.benchmark.studies.conftest import printed_table
from tests.worlds import generated
from tests.worlds.traced import write_dataset


@pytest.mark.parametrize("turns", range(4))
def test_objects_adjoin_along_either_axis_and_not_across_a_corner(turns: int):
    beside, corner = np.array([[0, 1, 2], [0, 0, 0]]), np.array([[0, 1, 0], [0, 0, 2]])
    assert objects_adjoin(np.rot90(beside, turns))
    assert not objects_adjoin(np.rot90(corner, turns))
    assert not objects_adjoin(np.array([[0, 1, 1], [0, 0, 1]]))


def test_every_image_with_several_objects_counts_in_one_of_the_two_kinds(tmp_path: Path):
    generated.make(tmp_path / "data", {"test": 4})
    scenes = Dataset(tmp_path / "data").split("test")
    truths = [read_truth(scenes, index) for index in range(len(scenes))]
    with write_labels(tmp_path / "one.h5", len(truths), tmp_path / "data") as writer:
        for index, (truth, _) in enumerate(truths):
            # All objects in one slot: ARI-FG is 0 wherever there are several.
            writer.put(index, Prediction((truth > 0).astype(np.int64), 0))
    adjoin, scores = scores_by_adjoining(tmp_path / "one.h5", truths)
    images = [image for truth, _ in truths for image in truth.reshape(-1, *truth.shape[2:])]
    several = [image for image in images if len(np.unique(image[image > 0])) > 1]
    assert adjoin.tolist() == [objects_adjoin(image) for image in several]
    assert (scores[:, 0] == 0).all()


def test_pixels_without_depth_do_not_count(tmp_path: Path):
    noisy = write_dataset(tmp_path / "noisy", scenes=2, spheres=3, sensor=True)
    scenes = Dataset(noisy).split("test")
    truths, clips = [read_truth(scenes, index) for index in range(len(scenes))], ClipSequence(scenes)
    with write_labels(tmp_path / "mine.h5", len(scenes), noisy) as writer:
        for index, (truth, _) in enumerate(truths):
            assert not clips[index].valid[truth > 0].all()
            writer.put(index, Prediction(np.where(clips[index].valid, truth, 9), 0))
    _, scores = scores_by_adjoining(tmp_path / "mine.h5", truths)
    assert len(scores)
    assert (scores == 1).all()


def test_the_command_shows_objects_that_share_a_slot_from_the_second_frame_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    data = write_dataset(tmp_path / "data", scenes=3, frames=4, spheres=3)
    with write_labels(tmp_path / "one.h5", 3, data) as writer:
        for index, record in enumerate(Dataset(data).split("test")):
            labels = record["segmentation"].astype(np.int64)
            labels[1:] = np.where(labels[1:] > 0, 1, 0)
            writer.put(index, Prediction(labels, 0))
    assert main(["errors", str(tmp_path / "one.h5"), "--csv", str(tmp_path / "errors.csv")]) == EXIT_OK
    printed = capsys.readouterr().out
    assert "merged: shares its slot with another object" in printed
    lines = {line["objects in"]: line for line in printed_table(printed)}
    assert (lines["first frames"]["best IoU"], lines["first frames"]["merged"]) == ("1", "0")
    assert lines["last frames"]["merged"] == "1"
    assert lines["all"]["split"] == lines["all"]["missed"] == "0"
    assert sum(int(line["objects"]) for name, line in lines.items() if name.endswith("in view")) == int(
        lines["all"]["objects"]
    )
    assert (tmp_path / "errors.csv").read_text().startswith("labels,objects in,objects,merged,")
