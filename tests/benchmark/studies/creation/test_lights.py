import csv
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from benchmark.studies.creation import lights_cli
from benchmark.studies.creation.lights_cli import Found, angle, main, table
from datagen.storage.reader import Dataset
from obpose.scenes.appearance.light import no_light


def test_angles_are_in_degrees():
    assert angle(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.6, 0.8])) == pytest.approx(36.87, abs=0.01)
    assert angle(np.array([1.0, 0.0, 0.0]), np.array([1.0 + 1e-9, 0.0, 0.0])) == 0


def test_scenes_without_a_light_count_as_not_found():
    rows = list(table([Found(0.2, 1.0), Found(0.4, 5.0), Found(0.3, 3.0), Found(0.0, float("nan"))]))
    assert rows[-1] == "| 4 | 3 | 3.0° | 4.6° | 5.0° | 0.30 |"
    assert list(table([Found(0.0, float("nan"))]))[-1] == "| 1 | 0 | | | | |"


def test_each_scene_is_compared_with_the_light_that_casts_its_shadows(
    clips: Path, checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    records = Dataset(clips).split("test")
    lights = [torch.cat([torch.tensor(records[0]["lights/direction"][0]).float(), torch.tensor([0.5])]), no_light()]

    def infer(*_: object, **__: object) -> SimpleNamespace:
        return SimpleNamespace(appearance=SimpleNamespace(light=lights.pop(0)))

    monkeypatch.setattr(lights_cli, "infer_scene", infer)
    path = tmp_path / "lights.csv"
    assert main(["--data", str(clips), "--checkpoint", str(checkpoint), "--csv", str(path)]) == 0
    with path.open() as file:
        one, other = csv.DictReader(file)
    assert float(one["degrees"]) == pytest.approx(0, abs=0.05)
    assert one["scene"] == "0"
    assert float(one["strength"]) == 0.5
    assert float(other["strength"]) == 0
