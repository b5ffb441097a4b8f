from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmark.studies.claims.shapes import measure_times, shape_errors
from datagen.shapes.shape import Shape
from obpose.model.nerf.field import Conditioning, Field, Hidden
from obpose.types import SceneSegmentation
from tests.benchmark.studies.claims.oracle_model import only_scene, true_account
from tests.obpose.analytic_fields import SMALL, empty_field

pytestmark = pytest.mark.usefixtures("short_clips")


def only(segmentation: SceneSegmentation, row: int) -> SceneSegmentation:
    """Of one object."""
    return replace(segmentation, labels=segmentation.labels * (segmentation.labels == row + 1))


class TrueField(Field):
    """The generator's shape in its box of 30 cm."""

    def __init__(self, shape: Shape):
        super().__init__(SMALL, latent=32)
        self.shape = shape

    def density(self, points: Tensor, codes: Conditioning) -> tuple[Tensor, Hidden]:
        distance = self.shape.signed_distance(0.15 * points.reshape(-1, 3).double().numpy())
        logits = torch.from_numpy(np.clip(-1e5 * distance, -20, 20)).float().view(points.shape[:-1])
        return logits, Hidden(points.new_zeros(*logits.shape, 16), None)


def test_a_true_field_has_the_true_voxels(claims_dataset: Path):
    """But for the few at its border that a pixel beside the object shows to be free."""
    told = true_account(only_scene(claims_dataset))
    largest = max(told.found, key=lambda found: told.scene.truth.shapes[found.row].volume)
    told.model.object_field = TrueField(told.scene.truth.shapes[largest.row])
    errors = shape_errors(replace(told, segmentation=only(told.segmentation, largest.row)))
    assert len(errors) == len(largest.frames)
    assert min(error.fine_iou for error in errors) > 0.85
    assert max(error.voxels for error in errors) < 0.3 / 12


def test_an_empty_field_has_none(claims_dataset: Path):
    told = true_account(only_scene(claims_dataset))
    told.model.object_field = empty_field(latent=32)
    assert all(error.iou == 0 and error.voxels == error.rendered == np.inf for error in shape_errors(told))


def test_voxels_are_faster_than_rendering(claims_dataset: Path):
    times = measure_times(true_account(only_scene(claims_dataset)), rounds=1)
    assert times.voxels < times.objects_alone < times.rendering
