from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmark.studies.__main__ import main
from benchmark.studies.voxel_shapes import measure_times, shape_errors, summary, true_center
from datagen.errors import EXIT_OK
from datagen.shapes.shape import Shape
from obpose.model.nerf.field import Conditioning, Field, Hidden
from obpose.storage.checkpoint import save_model
from tests.benchmark.studies.oracle_model import printed_table, relabelled, true_clip, untrained
from tests.obpose.analytic_fields import SMALL, empty_field

T_SHAPE, RENDERED = "distance of T_shape, centre of the voxels", "distance of the centre of the rendered surface"


class TrueField(Field):
    """The generator's shape in its box of 30 cm."""

    def __init__(self, shape: Shape):
        super().__init__(SMALL, latent=32)
        self.shape = shape

    def density(self, points: Tensor, codes: Conditioning) -> tuple[Tensor, Hidden]:
        distance = self.shape.signed_distance(0.15 * points.reshape(-1, 3).double().numpy())
        logits = torch.from_numpy(np.clip(-1e5 * distance, -20, 20)).float().view(points.shape[:-1])
        return logits, Hidden(points.new_zeros(*logits.shape, 16), None)


def test_a_true_field_has_the_true_voxels(oracle_dataset: Path):
    """Except for a few at its border that a pixel beside the object shows to be free."""
    clip = true_clip(oracle_dataset)
    largest = max(clip.followed, key=lambda each: clip.truth.shapes[each.row].volume)
    clip.model.object_field = TrueField(clip.truth.shapes[largest.row])
    labels = clip.segmentation.labels
    errors = list(shape_errors(relabelled(clip, labels * (labels == largest.row + 1))))
    assert len(errors) == len(largest.frames)
    assert min(error["IoU, S = 24 (authors)"] for error in errors) > 0.85
    assert max(error[T_SHAPE] for error in errors) < 0.3 / 12


def test_an_empty_field_has_no_voxels(oracle_dataset: Path):
    clip = true_clip(oracle_dataset)
    clip.model.object_field = empty_field(latent=32)
    errors = list(shape_errors(clip))
    assert errors
    assert all(error["IoU, S = 12"] == 0 and error[T_SHAPE] == error[RENDERED] == np.inf for error in errors)


def test_the_centre_of_an_object_lies_between_its_extremes(oracle_dataset: Path):
    clip = true_clip(oracle_dataset)
    for row, shape in enumerate(clip.truth.shapes):
        pose = clip.truth.world_from_object[1, row]
        reach = (torch.from_numpy(shape.vertices @ pose[:3, :3].T + pose[:3, 3]) - true_center(clip, row, 1)).numpy()
        assert reach.max(axis=0) == pytest.approx(-reach.min(axis=0), abs=1e-6)


def test_voxels_are_faster_than_rendering(oracle_dataset: Path):
    voxels, rendering, objects_alone = measure_times(true_clip(oracle_dataset), rounds=1).values()
    assert voxels[0] < objects_alone[0] < rendering[0]


def test_undefined_values_are_counted_and_left_out():
    assert summary("a", [1.0, np.inf, 4.0, 1.0]) == {"what": "a", "median": 1.0, "mean": 2.0, "undefined": 1}
    assert np.isnan(summary("a", [np.inf])["median"])


@pytest.mark.slow
def test_the_command_summarises(oracle_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    model = untrained()
    save_model(tmp_path / "model", model.state_dict(), model.config, {})
    flags = ["--data", str(oracle_dataset), "--split", "val", "--checkpoint", str(tmp_path / "model")]
    assert main(["voxel_shapes", *flags, "--csv", str(tmp_path / "a.csv")]) == EXIT_OK
    printed = capsys.readouterr().out
    assert "objects of 1 scenes are followed" in printed
    assert [line["what"] for line in printed_table(printed)][-3] == "CPU seconds, voxels"
    assert (tmp_path / "a.csv").read_text().startswith("model,data,split,what,median,mean,undefined")
