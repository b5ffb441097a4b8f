from pathlib import Path

import pytest
from PIL import Image

from benchmark.studies.claims.edits_cli import main
from datagen.errors import EXIT_OK, EXIT_USAGE
from datagen.pipeline.generate import generate
from datagen.schema import EDITS
from tests.worlds import generated


@pytest.fixture(scope="module")
def edits(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("edits") / "scenes"
    generate(folder, generated.recipe(frames=1), splits={"test": 1}, resolution=(32, 32), edits=EDITS)
    return folder


def test_a_picture_has_a_column_for_each_edit_and_three_rows_a_scene(edits: Path, tmp_path: Path):
    wanted = ("--data", str(edits), "--checkpoint", "obpose--moving--64x64", "--out", str(tmp_path / "edits.png"))
    assert main(wanted) == EXIT_OK
    with Image.open(tmp_path / "edits.png") as picture:
        assert picture.size == (4 * 160, 3 * 160)


def test_scenes_that_are_not_there_are_refused(edits: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    wanted = ("--data", str(edits), "--checkpoint", "obpose--moving--64x64", "--out", str(tmp_path / "edits.png"))
    assert main((*wanted, "--scenes", "0", "1")) == EXIT_USAGE
    assert "--scenes 1: split test" in capsys.readouterr().err
