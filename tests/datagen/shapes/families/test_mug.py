import numpy as np
import pytest

from datagen.shapes.families.lathe import turned
from datagen.shapes.families.mug import build


def test_a_mug_counts_what_handle_and_wall_share_once():
    size = {"radius": 0.04, "height": 0.09, "wall": 0.006, "floor": 0.005}
    band_size = {"handle_height": 0.06, "handle_reach": 0.03, "handle_thickness": 0.008, "handle_width": 0.02}
    mug = build(**size, **band_size)
    body = turned([[0.04, 0.0], [0.04, 0.09]], 0.006, 0.005).mass
    band = mug.solids[1]
    step = 8e-4
    axes = [np.arange(low, high, step) + step / 2 for low, high in ((0, 0.075), (-0.01, 0.01), (-0.03, 0.03))]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    outside = np.hypot(points[:, 0], points[:, 1]) > 0.04
    center = np.array([mug.vertices[:, 0].max() - 0.07, 0, mug.vertices[:, 2].min() + 0.045])
    handle = points[outside & (band.signed_distance(points + center) < 0)]
    handle_volume = len(handle) * step**3
    assert mug.volume - body.volume == pytest.approx(handle_volume, rel=0.02)
    # The body alone has its centre of mass on its axis.
    assert -center[0] * mug.volume == pytest.approx(handle_volume * handle[:, 0].mean(), rel=0.02)
