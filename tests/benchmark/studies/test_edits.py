from pathlib import Path

import pytest
from PIL import Image

from benchmark.studies.__main__ import main
from datagen.errors import EXIT_OK, EXIT_USAGE
from datagen.pipeline.generate import generate
from datagen.schema import EDITS
from tests.worlds import generated


def test_the_picture_has_a_column_for_each_edit_and_three_rows_a_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    data, picture = tmp_path / "scenes", tmp_path / "edits.png"
    generate(data, generated.recipe(frames=1), splits={"test": 1}, resolution=(32, 32), edits=EDITS)
    command = ["edits", "--data", str(data), "--checkpoint", "obpose--moving--64x64", "--picture", str(picture)]
    assert main(command) == EXIT_OK
    with Image.open(picture) as drawn:
        assert drawn.size == (4 * 160, 3 * 160)
    assert main([*command, "--scenes", "0", "1"]) == EXIT_USAGE
    assert "--scenes 1: split test" in capsys.readouterr().err
