from pathlib import Path

import numpy as np

from datagen.formats.silhouettes import silhouettes, stage_of_scene
from tests.datagen.formats.conftest import source


def test_silhouettes_have_the_stored_number_of_pixels_and_hold_what_is_visible(stills: Path):
    scene = source(stills)
    for row, masks in enumerate(silhouettes(scene, stage_of_scene(scene))):
        stored = scene.read("visibility/amodal_pixels")[..., row]
        np.testing.assert_array_equal(np.count_nonzero(masks, axis=(2, 3)), stored)
        assert not np.any((scene.segmentation == row + 1) & ~masks)
