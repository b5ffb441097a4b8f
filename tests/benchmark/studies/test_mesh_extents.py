from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.studies.__main__ import main
from benchmark.studies.mesh_extents import compare, match
from datagen.errors import EXIT_USAGE
from obpose.scenes.infer import Inferred
from tests.obpose.analytic_fields import BallField
from tests.obpose.scenes.small_scenes import some_model, some_scene
from tests.worlds.imported import import_balls


def test_objects_are_matched_by_the_overlap_of_their_masks():
    truth, found = np.zeros((20, 20), int), np.zeros((20, 20), int)
    truth[:8, :8], found[:8, :7] = 1, 5  # IoU 0.875
    truth[10:18, :8], found[10:18, 4:12] = 2, 3  # IoU 1/3
    truth[:8, 12:], found[:8, 12:] = 3, 0  # not found
    truth[18:, 18:], found[18:, 18:] = 4, 2  # too few pixels
    assert list(match(truth, found)) == [(0, 5)]


def test_errors_are_relative_extents_along_the_true_axes():
    """A ball of 10 cm is compared with a box of 8 x 10 x 5 cm that is turned about the vertical."""
    model, scene = some_model(), some_scene(objects=1, frames=1)
    model.object_field = BallField(0.5, latent=32)
    scene = replace(scene, center=torch.tensor([[[0.0, 0.0, 0.2]]]), rotation=torch.eye(3)[None, None])
    scene = scene.with_appearance(detail=torch.zeros_like(scene.appearance.detail))
    scene = scene.with_appearance(half_extent=torch.full((1, 3), 0.04))
    truth = np.zeros((1, 1, 10, 10), np.int64)
    truth[0, 0, 2:8, 2:8] = 1
    record = {
        "segmentation": truth,
        "poses/quaternion_wxyz": np.array([[[np.cos(0.4), 0.0, 0.0, np.sin(0.4)]]]),
        "objects/size": np.array([[0.08, 0.1, 0.05]]),
    }
    found = list(compare(model, Inferred(scene, torch.from_numpy(truth)), record))
    assert len(found) == 6
    for _, shrunk, errors in found:
        if shrunk:
            assert errors[2] == pytest.approx(0.6, abs=0.03)
        else:
            np.testing.assert_allclose(errors, [0.25, 0.0, 1.0], atol=0.03)


def test_a_dataset_without_poses_is_refused(tmp_path: Path, checkpoint: Path, capsys: pytest.CaptureFixture[str]):
    folder = import_balls(tmp_path).folder
    assert main(["mesh_extents", "--data", str(folder), "--checkpoint", str(checkpoint)]) == EXIT_USAGE
    assert "lacks masks, poses or sizes of objects" in capsys.readouterr().err


def test_it_runs_on_a_dataset_and_refuses_numbers_out_of_range(
    clips: Path, checkpoint: Path, capsys: pytest.CaptureFixture[str]
):
    arguments = ["mesh_extents", "--data", str(clips), "--checkpoint", str(checkpoint), "--refine", "0"]
    assert main([*arguments, "--scenes", "0"]) == EXIT_USAGE
    assert "--scenes 0: expected 1 or more" in capsys.readouterr().err
    assert main([*arguments, "--scenes", "1"]) == 0
