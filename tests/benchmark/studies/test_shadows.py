import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from benchmark.models.interface import Prediction
from benchmark.results.labels import write_labels
from benchmark.studies.__main__ import main
from benchmark.studies.shadows import count_pixels, in_shadow, score_ways, shadow_owners
from datagen.errors import EXIT_OK, EXIT_USAGE
from datagen.pipeline.generate import generate, render
from datagen.storage.reader import Dataset
from tests.benchmark.studies.oracle_model import printed_table
from tests.worlds import generated

TRUTH = np.array([[[[0, 0, 0, 1], [0, 0, 2, 2]]]], np.uint8)
OWNERS = np.array([[[[0, 1, 1, 0], [2, 0, 0, 0]]]], np.uint8)
ALL_SEEN = np.zeros(TRUTH.shape, bool)


def ari(labels: np.ndarray, unseen: np.ndarray = ALL_SEEN) -> dict[str, float]:
    found = score_ways(TRUTH, labels.astype(int), 0, OWNERS > 0, OWNERS, unseen)
    return {way: scores["ari"] for way, scores in found.items()}


def test_each_way_of_counting_is_right_for_one_segmentation():
    ways = ari(TRUTH)
    assert ways["background's"] == ways["nobody's"] == 1 > ways["object's"]
    ways = ari(np.where(OWNERS > 0, OWNERS, TRUTH))
    assert ways["object's"] == ways["nobody's"] == 1 > ways["background's"]


def test_an_object_that_takes_its_shadow_is_wrong_there_alone():
    labels = TRUTH.astype(int)
    perfect = count_pixels(TRUTH, labels + 1, 1, OWNERS > 0, ALL_SEEN)
    assert list(perfect.values()) == [5, 3, 0, 0, 0]
    labels[0, 0, 0, 2], labels[0, 0, 1, 2] = 1, 0
    counts = count_pixels(TRUTH, labels, 0, OWNERS > 0, ALL_SEEN)
    assert (counts["missed"], counts["leaked"], counts["leaked in shadow"]) == (1, 1, 1)


def test_pixels_without_depth_never_count():
    labels = np.where(OWNERS > 0, 3, TRUTH).astype(int)
    assert list(count_pixels(TRUTH, labels, 0, OWNERS > 0, OWNERS > 0).values()) == [2, 0, 0, 0, 0]
    assert set(ari(labels, unseen=OWNERS > 0).values()) == {1}


def test_shadows_on_objects_do_not_count_and_shared_ones_belong_to_the_first():
    masks = np.zeros((*TRUTH.shape, 2), bool)
    masks[0, 0, 0, 1] = masks[0, 0, 0, 3] = [True, True]
    masks[0, 0, 1, 0] = [False, True]
    effects = np.packbits(masks, axis=-1, bitorder="little")
    assert shadow_owners(TRUTH, effects, 2).tolist() == [[[[0, 1, 0, 0], [2, 0, 0, 0]]]]


def test_rounding_makes_no_shadow():
    image = np.full((2, 3), 100, dtype=np.uint8)
    assert not in_shadow(image, image + 1).any()
    assert in_shadow(image, image + 2).all()


@pytest.fixture(scope="module")
def datasets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same two scenes with shadows, without them, and with effect masks; and other scenes."""
    folder = tmp_path_factory.mktemp("shadows")
    recipe = generated.recipe()
    for name, shadows in (("with", True), ("without", False)):
        lit = dataclasses.replace(recipe, lighting=dataclasses.replace(recipe.lighting, shadows=shadows))
        generate(folder / name, lit, splits={"test": 2}, seed=0, resolution=generated.RESOLUTION)
    render(folder / "with", folder / "effects", edits=("remove",))
    generated.make(folder / "other", {"test": 2}, seed=7)
    return folder


def predict(path: Path, data: Path, *, everything: bool = False) -> str:
    """True labels, or those of one object that is everywhere."""
    with write_labels(path, 2, data) as writer:
        for index, record in enumerate(Dataset(data).split("test")):
            labels = record["segmentation"].astype(np.int64)
            writer.put(index, Prediction(np.ones_like(labels) if everything else labels, 0))
    return str(path)


@pytest.mark.parametrize(
    ("source", "ways"),
    [("without", ["background's", "nobody's"]), ("effects", ["background's", "object's", "nobody's"])],
)
def test_the_command_scores_true_labels_and_finds_errors_in_shadows(
    source: str, ways: list[str], datasets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    files = [predict(tmp_path / "true.h5", datasets / "with")]
    files.append(predict(tmp_path / "all.h5", datasets / "with", everything=True))
    command = ["shadows", *files, f"--{source}", str(datasets / source), "--csv", str(tmp_path / "a.csv")]
    assert main(command) == EXIT_OK
    lines = printed_table(capsys.readouterr().out)
    assert [(line["labels"], line["shadows are the"]) for line in lines] == [
        (name, way) for name in ("true", "all") for way in ways
    ]
    true, wrong = lines[: len(ways)], lines[-1]
    assert [line["ari"] == "1" for line in true] == [way != "object's" for way in ways]
    assert true[0]["missed"] == true[0]["leaked"] == "0"
    assert wrong["leaked"] == wrong["background"]
    assert 0.005 < int(wrong["leaked in shadow"]) / int(wrong["background"]) < 0.2
    written = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert [line["ari"] == "1.000000" for line in written] == [line["ari"] == "1" for line in lines]


@pytest.mark.parametrize(
    ("sources", "said"),
    [
        ("--without other", "expected the same scenes"),
        ("", "Make them with --edits remove"),
        ("--without without --effects effects", "expected one of the two"),
    ],
)
def test_unfit_datasets_are_refused(
    sources: str, said: str, datasets: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    labels = predict(tmp_path / "true.h5", datasets / "with")
    flags = [word if word.startswith("--") else str(datasets / word) for word in sources.split()]
    assert main(["shadows", labels, *flags]) == EXIT_USAGE
    assert said in capsys.readouterr().err
