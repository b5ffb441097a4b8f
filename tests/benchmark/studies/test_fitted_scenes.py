from pathlib import Path

import pytest
import torch
from PIL import Image

from benchmark.studies.__main__ import main
from benchmark.studies.fitted_scenes import SHIFT, TIMES, move_largest
from datagen.errors import EXIT_OK
from obpose.scenes.clip import read_clip
from obpose.scenes.infer import infer_labelled
from obpose.scenes.model_ref import Origin


def test_the_largest_object_is_moved(clips: Path, origin: Origin):
    scene = infer_labelled(origin, read_clip(clips, "test", 0)).scene
    labels = torch.tensor([[0, 0, 0], [1, 2, 2]])
    moved = move_largest(scene, labels).center - scene.center
    torch.testing.assert_close(moved[:, 1], torch.tensor(SHIFT).expand(len(moved), 3))
    assert not moved[:, 0].any()
    assert move_largest(scene, torch.zeros_like(labels)) is scene


@pytest.mark.slow
def test_the_command_draws_four_pictures_a_scene(clips: Path, checkpoint: Path, tmp_path: Path):
    picture = tmp_path / "fitted.png"
    flags = f"--data {clips} --checkpoint {checkpoint} --scenes 1 --picture {picture}".split()
    assert main(["fitted_scenes", *flags]) == EXIT_OK
    with Image.open(picture) as drawn:
        assert drawn.size == (4 * TIMES * 32, TIMES * 32)
