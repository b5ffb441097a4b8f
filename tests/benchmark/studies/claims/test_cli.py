import itertools
from pathlib import Path

import pytest
from PIL import Image

from benchmark.studies.claims.cli import main
from benchmark.studies.claims.figures import LINE, MARGIN, TILE
from datagen.errors import EXIT_USAGE
from obpose.config import override
from obpose.storage.checkpoint import save_model
from tests.benchmark.studies.claims.oracle_model import untrained

COARSE = 4


@pytest.fixture
def checkpoints(tmp_path: Path) -> list[str]:
    """Untrained models of all three kinds."""
    for conditioning in ("none", "location", "full"):
        model = untrained(conditioning)
        save_model(tmp_path / conditioning, model.state_dict(), model.config, {})
    return [f"{conditioning}={tmp_path / conditioning}" for conditioning in ("none", "location", "full")]


@pytest.fixture
def generous(monkeypatch: pytest.MonkeyPatch, short_clips: None) -> None:
    """An object is always somebody's, and pictures are quickly drawn."""
    monkeypatch.setattr("benchmark.studies.claims.scenes.LEAST_IOU", -1.0)
    for module in ("cli", "shapes"):
        monkeypatch.setattr(f"benchmark.studies.claims.{module}.FINE", COARSE)


def claims(folder: Path, out: Path, *flags: str, scenes: int = 1) -> int:
    return main(
        ["--data", str(folder), "--scenes", str(scenes), "--figure-scenes", "0", "0", "--out", str(out), *flags]
    )


@pytest.mark.usefixtures("generous")
def test_three_models_give_tables_and_pictures(
    claims_dataset: Path, tmp_path: Path, checkpoints: list[str], capsys: pytest.CaptureFixture[str]
):
    assert claims(claims_dataset, tmp_path / "out", "--checkpoint", *checkpoints) == 0
    printed = capsys.readouterr().out
    assert "IoU of the voxels" in printed
    assert all(f"| move | {kind} | {kind} |" in printed for kind in ("none", "location", "full"))
    for name in ("voxels_and_poses.png", "object_frames.png"):
        sheet = Image.open(tmp_path / "out" / name)
        assert sheet.height == LINE + 3 * TILE
        for corner in itertools.product(range(MARGIN, sheet.width, TILE), range(LINE, sheet.height, TILE)):
            tile = sheet.crop((*corner, *(place + TILE for place in corner)))
            assert tile.getextrema() != ((255, 255),) * 3


@pytest.mark.usefixtures("generous")
def test_a_conditioning_without_a_model_is_shown_by_the_full_one(
    claims_dataset: Path, tmp_path: Path, checkpoints: list[str], capsys: pytest.CaptureFixture[str]
):
    assert claims(claims_dataset, tmp_path / "out", "--checkpoint", checkpoints[2]) == 0
    assert "| move | none | full |" in capsys.readouterr().out


def test_what_cannot_be_done_is_said_in_one_line(
    claims_dataset: Path, tmp_path: Path, checkpoints: list[str], capsys: pytest.CaptureFixture[str]
):
    swapped = checkpoints[0].replace("none=", "full=")
    for flags, scenes, said in (
        (["--checkpoint", "none"], 1, "--checkpoint none: expected none=DIR, location=DIR, full=DIR"),
        (["--checkpoint", swapped], 1, "trained with conditioning 'none', expected 'full'"),
        (["--checkpoint", *checkpoints], 0, "expected two of the 0 scenes"),
        (["--checkpoint", *checkpoints], 1, "choose other --figure-scenes"),
    ):
        assert claims(claims_dataset, tmp_path / "out", *flags, scenes=scenes) == 2
        assert said in capsys.readouterr().err


def test_a_scene_in_which_nothing_is_found_is_refused(
    claims_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    model = untrained()
    blind = override(model.config, {"model.attention.inactive_points": 10**6})
    save_model(tmp_path / "blind", model.state_dict(), blind, {})
    assert claims(claims_dataset, tmp_path / "out", "--checkpoint", f"full={tmp_path / 'blind'}") == EXIT_USAGE
    assert "No object of this scene is followed" in capsys.readouterr().err
