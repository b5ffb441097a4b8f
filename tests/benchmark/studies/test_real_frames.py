import csv
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmark.commands import cli
from benchmark.commands.request import FITTED_ON
from benchmark.studies.__main__ import main
from datagen import tracks
from datagen.commands.cli import main as datagen
from datagen.config import load_recipe
from datagen.errors import EXIT_OK, EXIT_USAGE
from datagen.pipeline.generate import generate
from tests.worlds.imported import import_balls
from tests.worlds.sphere_clips import clip_and_truth

WEIGHTS = "supervised--desk--128x96"


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A frame with a true mask, one with a predicted mask, one whose mask does not tell objects apart, and one without
    a table."""
    clip, truth = clip_and_truth(frames=1, resolution=(160, 120))
    noise = np.random.default_rng(0).integers(8000, 30_000, truth[0, 0].shape, dtype=np.uint16)
    exact = (clip.depth[0, 0] * 10_000).round().astype(np.uint16)
    masks = {"balls": "by hand", "guessed": "PREDICTED by a model", "joined": "foreground", "noise": "by hand"}
    for name, mask in masks.items():
        folder = tmp_path / "source" / name
        folder.mkdir(parents=True)
        Image.fromarray(clip.rgb[0, 0]).save(folder / "color.png")
        Image.fromarray(noise if name == "noise" else exact).save(folder / "depth.png")
        Image.fromarray(truth[0, 0]).save(folder / "mask.png")
        facts = {"K": clip.k[0].tolist(), "pixel_center": 0.5, "depth_scale_m": 0.0001, "mask": mask}
        (folder / "camera.json").write_text(json.dumps(facts))
    return tmp_path / "source"


def test_true_and_predicted_masks_are_rows_of_their_own(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path / "cache"))
    fitted = tracks.find_track(FITTED_ON)  # with fewer scenes than usual
    generate(fitted.folder, load_recipe(FITTED_ON), splits={"val": 2}, resolution=fitted.resolution)
    command = ["import", "--format", "rgbd", str(source), "--split", "test"]
    out = tmp_path / "run"
    for name, flags in {"true": [], "predicted": ["--predicted-masks"]}.items():
        assert datagen([*command, *flags, "--out", str(tmp_path / name)]) == EXIT_OK
        models = ["--checkpoint", WEIGHTS, *(["--model", "plane-components"] if name == "true" else [])]
        assert tracks.RealTable(tmp_path / name).slots == 17, "masks must not tell the number of objects"
        run = ["--track", tracks.REAL_TABLE, "--data", str(tmp_path / name), *models, "--seeds", "1"]
        assert cli.main([*run, "--out", str(out), "--workers", "1"]) == EXIT_OK
    assert "Masks of 2 recordings left out" in capsys.readouterr().out
    drawn, table = tmp_path / "drawn", tmp_path / "a.csv"
    assert main(["real_frames", str(out), "--csv", str(table), "--pictures", str(drawn)]) == EXIT_OK
    lines = {
        (line["masks"], line["model"], line["frame"]): line for line in csv.DictReader(table.read_text().splitlines())
    }
    assert {(masks, frame) for masks, model, frame in lines if model == WEIGHTS} == {
        ("real-table", "balls"), ("real-table", "noise"), ("real-table", "mean of 2"),
        ("real-table-predicted", "guessed"), ("real-table-predicted", "mean of 1"),
    }  # fmt: skip
    for masks, frame in (("real-table", "balls"), ("real-table-predicted", "guessed")):
        assert float(lines[masks, WEIGHTS, frame]["ari_fg"]) > 0.9
        assert [*drawn.glob(f"*-{frame}--{WEIGHTS}-0.png")]
    assert float(lines["real-table", "plane-components", "balls"]["ari_fg"]) > 0.9


def test_given_masks_may_have_any_background_slot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path / "cache"))
    frames = import_balls(tmp_path / "frames", masks=("test",))
    truth = frames.split("test")[0]["segmentation"]
    (tmp_path / "mine" / "test").mkdir(parents=True)
    labels = np.where(truth == 0, 5, np.where(truth == 1, 0, truth))
    np.savez(tmp_path / "mine" / "test" / "00000.npz", labels=labels, background_slot=5)
    run = ["--track", tracks.REAL_TABLE, "--data", str(frames.folder), "--predictions", str(tmp_path / "mine")]
    assert cli.main([*run, "--out", str(tmp_path / "run"), "--workers", "1"]) == EXIT_OK
    assert main(["real_frames", str(tmp_path / "run"), "--csv", str(tmp_path / "a.csv")]) == EXIT_OK
    lines = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert [(line["msc_fg"], line["false objects"]) for line in lines] == [("1.000000", "0"), ("1.000000", "0.000000")]


def test_a_run_without_real_tables_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["real_frames", str(tmp_path)]) == EXIT_USAGE
    assert "has no results on track real-table" in capsys.readouterr().err


def test_the_track_needs_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert cli.main(["--track", "real-table", "--model", "one-cluster", "--out", str(tmp_path)]) == EXIT_USAGE
    assert "name a dataset that holds them with --data" in capsys.readouterr().err


def test_only_the_track_itself_has_its_name(source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = str(tmp_path / "real-table")
    assert datagen(["import", "--format", "rgbd", str(source), "--split", "test", "--out", folder]) == EXIT_OK
    run = ["--data", folder, "--model", "one-cluster", "--out", str(tmp_path / "out")]
    assert cli.main(run) == EXIT_USAGE
    assert "has the name of a track; add --track real-table" in capsys.readouterr().err
    assert cli.main(["--track", "real-table", "--task", "editing", *run]) == EXIT_USAGE
    assert "--track real-table is for segmentations" in capsys.readouterr().err
