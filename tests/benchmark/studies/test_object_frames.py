from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.studies.__main__ import main
from benchmark.studies.object_frames import (
    FRAMINGS,
    code_variance,
    mean_variances,
    occupancy_variance,
    path_length,
    variances,
)
from datagen.errors import EXIT_OK, EXIT_USAGE
from obpose.storage.checkpoint import save_model
from tests.benchmark.studies.oracle_model import true_clip, untrained


def test_occupancy_that_stays_does_not_vary_and_one_that_leaves_varies_most():
    frames = 4
    assert occupancy_variance(torch.tensor([[True, False]]).expand(frames, 2)) == 0
    assert occupancy_variance(torch.eye(frames, dtype=torch.bool)) == pytest.approx(1 - 1 / frames)
    assert np.isnan(occupancy_variance(torch.zeros(frames, 2, dtype=torch.bool)))


def test_codes_vary_between_objects_or_within_them():
    rng = np.random.default_rng(0)
    steady = [np.tile(rng.normal(size=8), (5, 1)) for _ in range(50)]
    restless = [3 * rng.normal(size=(5, 8)) for _ in range(50)]
    assert code_variance(steady) == pytest.approx(0, abs=1e-12)
    assert code_variance(restless) == pytest.approx(0.8, abs=0.05)  # of five frames: 1 - 1/5


def test_a_rigid_object_does_not_vary_in_its_own_frame(oracle_dataset: Path):
    clip = true_clip(oracle_dataset)
    # Thin objects can lie between the cells' centres.
    thick = [each for each in clip.followed if np.isfinite(variances(clip, each, "full")["truth"])]
    turning = max(thick, key=lambda each: clip.turned(each.row, each.frames).max())
    in_full, in_location, in_world = (variances(clip, turning, framing) for framing in ("full", "location", "none"))
    assert in_full["truth"] == in_full["centred"] == 0
    assert 0 < in_location["truth"] < in_world["truth"]
    assert path_length(clip, turning) > 0
    means = mean_variances([(clip, turning)], "full", codes=True)
    assert list(means) == ["truth", "centred", "field", "z_what"]
    assert means["truth"] == 0


def test_the_command_compares_models(oracle_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for conditioning in FRAMINGS:
        model = untrained(conditioning)
        save_model(tmp_path / conditioning, model.state_dict(), model.config, {})
    flags = ["--data", str(oracle_dataset), "--split", "val", "--checkpoint", str(tmp_path / "full")]
    others = ["--other-checkpoints", *(str(tmp_path / name) for name in ("none", "location"))]
    command = ["object_frames", *flags, "--csv", str(tmp_path / "frames.csv")]
    assert main([*command, *others]) == EXIT_OK
    assert (tmp_path / "frames.csv").exists()
    assert main([*command, others[0], str(tmp_path / "full")]) == EXIT_USAGE
    assert "The conditionings of the models are full; expected full, and at most one each" in capsys.readouterr().err
