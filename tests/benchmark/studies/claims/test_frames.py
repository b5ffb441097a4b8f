from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.studies.claims.frames import code_spread, spread, variance
from tests.benchmark.studies.claims.oracle_model import only_scene, true_account


def test_occupancy_that_stays_does_not_vary_and_one_that_leaves_varies_most():
    frames = 4
    assert spread(torch.tensor([[True, False]]).expand(frames, 2)) == 0
    assert spread(torch.eye(frames, dtype=torch.bool)) == pytest.approx(1 - 1 / frames)
    assert np.isnan(spread(torch.zeros(frames, 2, dtype=torch.bool)))


def test_codes_vary_between_objects_or_within_them():
    rng = np.random.default_rng(0)
    steady = [np.tile(rng.normal(size=8), (5, 1)) for _ in range(50)]
    restless = [3 * rng.normal(size=(5, 8)) for _ in range(50)]
    assert code_spread(steady) == pytest.approx(0, abs=1e-12)
    assert code_spread(restless) == pytest.approx(0.8, abs=0.05)  # of five frames: 1 - 1/5


@pytest.mark.usefixtures("short_clips")
def test_what_is_rigid_does_not_vary_in_its_own_frame(claims_dataset: Path):
    told = true_account(only_scene(claims_dataset))
    moving = max(told.found, key=lambda found: told.scene.angles(found.row, found.frames).max())
    in_full, in_location, in_world = (variance(told, moving, framing) for framing in ("full", "location", "none"))
    assert in_full.truth == in_full.centred == 0
    assert 0 < in_location.truth < in_world.truth
