from pathlib import Path

import numpy as np
import pytest

from benchmark.models.interface import Prediction
from benchmark.results.labels import write_labels
from benchmark.studies.claims import shadows_cli
from benchmark.studies.claims.effects_cli import compare, main, shadow_owners
from datagen.errors import EXIT_USAGE
from datagen.pipeline.generate import render
from datagen.schema import effect_mask
from datagen.storage.reader import Dataset
from tests.worlds import generated

TRUTH = np.array([[[[0, 0, 0, 1], [0, 0, 2, 2]]]], np.uint8)
OWNERS = np.array([[[[0, 1, 1, 0], [2, 0, 0, 0]]]], np.uint8)
NOTHING_UNSEEN = np.zeros(TRUTH.shape, bool)


def scores(labels: np.ndarray) -> dict[str, float]:
    found = compare(TRUTH, OWNERS, labels, 0, NOTHING_UNSEEN)
    return {way: found[way]["ari"] for way in found}


def test_each_way_of_counting_is_right_for_one_segmentation():
    ways = scores(TRUTH.astype(int))
    assert ways["background"] == ways["ignored"] == 1 > ways["object"]
    ways = scores(np.where(OWNERS > 0, OWNERS, TRUTH).astype(int))
    assert ways["object"] == ways["ignored"] == 1 > ways["background"]


def test_shadows_on_objects_belong_to_these_and_shared_ones_to_the_first():
    masks = np.zeros((*TRUTH.shape, 2), bool)
    masks[0, 0, 0, 1] = masks[0, 0, 0, 3] = [True, True]
    masks[0, 0, 1, 0] = [False, True]
    effects = np.packbits(masks, axis=-1, bitorder="little")
    assert shadow_owners(TRUTH, effects, 2).tolist() == [[[[0, 1, 0, 0], [2, 0, 0, 0]]]]


@pytest.fixture(scope="module")
def datasets(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two scenes, and the same with effects."""
    folder = tmp_path_factory.mktemp("effects")
    generated.make(folder / "plain", {"test": 2})
    render(folder / "plain", folder / "effects", edits=("remove",))
    return folder / "plain", folder / "effects"


def write(path: Path, data: Path) -> Path:
    """The true labels, shadows being part of the objects."""
    with write_labels(path, 2, data) as writer:
        for index, record in enumerate(Dataset(data).split("test")):
            labels = record["segmentation"].astype(np.int64)
            writer.put(index, Prediction(labels, 0))
    return path


def test_the_report_counts_shadows_in_three_ways(tmp_path: Path, datasets: tuple[Path, Path], capsys):
    plain, effects = datasets
    record = Dataset(effects).split("test")[0]
    assert any(np.any(effect_mask(record["edits/remove/effects"], name)) for name in (1, 2))
    table = tmp_path / "effects.csv"
    assert main([str(write(tmp_path / "true.h5", plain)), "--effects", str(effects), "--csv", str(table)]) == 0
    lines = [line.split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| true")]
    assert [line[1] for line in lines] == ["background's", "object's", "nobody's"]
    first = [line[2].startswith("1.000 (1.000 to 1.000)") for line in lines]
    assert first == [True, False, True]
    written = [line.split(",") for line in table.read_text().splitlines()]
    assert written[0][:4] == ["labels", "shadows are the", "scenes", "ari"]
    assert [(line[1], float(line[3]) == 1) for line in written[1:]] == list(
        zip([x[1] for x in lines], first, strict=True)
    )


def test_a_dataset_without_effects_and_one_of_other_scenes_are_refused(
    tmp_path: Path, datasets: tuple[Path, Path], capsys
):
    plain, _effects = datasets
    labels = write(tmp_path / "true.h5", plain)
    assert main([str(labels)]) == EXIT_USAGE
    assert "Make them with --edits remove" in capsys.readouterr().err
    generated.make(tmp_path / "other", {"test": 2}, seed=7)
    render(tmp_path / "other", tmp_path / "others", edits=("remove",))
    assert main([str(labels), "--effects", str(tmp_path / "others")]) == EXIT_USAGE
    assert "expected the same with effects" in capsys.readouterr().err


def test_missing_label_maps_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for run, more in ((main, []), (shadows_cli.main, ["--without", str(tmp_path)])):
        assert run([str(tmp_path / "none.h5"), *more]) == EXIT_USAGE
        told = capsys.readouterr().err
        assert "none.h5; expected label maps that a run of obpose-bench left" in told
        assert "delete" not in told
