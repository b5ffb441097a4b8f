import csv
from math import nan
from pathlib import Path

import numpy as np
import pytest

from benchmark.studies.__main__ import main
from benchmark.studies.lights import angle, summary
from datagen.errors import EXIT_OK


def test_angles_are_in_degrees():
    assert angle(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.6, 0.8])) == pytest.approx(36.87, abs=0.01)
    assert angle(np.array([1.0, 0.0, 0.0]), np.array([1.0 + 1e-9, 0.0, 0.0])) == 0


def test_scenes_without_a_light_count_as_not_found():
    found = [{"strength": s, "degrees": d} for s, d in ((0.2, 1.0), (0.4, 5.0), (0.3, 3.0), (0.0, nan))]
    counts, values = (4, 3), (3.0, 4.6, 5.0, 0.3)
    assert list(summary(found).values()) == pytest.approx([*counts, *values])
    assert summary(found[-1:]) == {"scenes": 1, "lights found": 0}


@pytest.mark.slow
def test_the_command_writes_a_line_for_each_scene(
    clips: Path, checkpoint: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    flags = ["--data", str(clips), "--checkpoint", str(checkpoint), "--scenes", "1", "--csv", str(tmp_path / "a.csv")]
    assert main(["lights", *flags]) == EXIT_OK
    assert "| scenes | lights found |" in capsys.readouterr().out
    (line,) = csv.DictReader((tmp_path / "a.csv").read_text().splitlines())
    assert [line[name] for name in ("data", "split", "scene")] == [clips.name, "test", "0"]
    assert (float(line["strength"]) > 0) == (line["degrees"] not in ("", "nan"))
