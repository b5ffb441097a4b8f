import csv
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from benchmark.studies.__main__ import main
from datagen.errors import EXIT_OK, EXIT_USAGE
from tests.worlds.sphere_clips import clip_and_truth


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """A frame with a mask, and one that shows no table."""
    clip, truth = clip_and_truth(frames=1, resolution=(160, 120))
    k = clip.k[0]
    facts = {"K": k.tolist(), "pixel_center": 0.5, "depth_scale_m": 0.0001, "mask": "PREDICTED by a model"}
    depth = (clip.depth[0, 0] * 10_000).round().astype(np.uint16)
    noise = np.random.default_rng(0).integers(8000, 30_000, depth.shape, dtype=np.uint16)
    for name, values in (("balls", depth), ("noise", noise)):
        (tmp_path / name).mkdir()
        Image.fromarray(clip.rgb[0, 0]).save(tmp_path / name / "color.png")
        Image.fromarray(values).save(tmp_path / name / "depth.png")
        (tmp_path / name / "camera.json").write_text(json.dumps(facts))
    Image.fromarray(truth[0, 0]).save(tmp_path / "balls" / "mask.png")
    return tmp_path


def test_frames_are_scored_and_drawn(frames: Path, capsys: pytest.CaptureFixture[str]):
    flags = ["--methods", "plane-hdbscan", "supervised--desk--128x96", "--csv", str(frames / "a.csv")]
    assert main(["real_frames", str(frames), *flags, "--pictures", str(frames / "drawn")]) == EXIT_OK
    lines = list(csv.DictReader((frames / "a.csv").read_text().splitlines()))
    assert [(line["frame"], line["method"]) for line in lines] == [
        (frame, method)
        for frame in ("balls", "noise", "mean of 1")
        for method in ("plane-hdbscan", "supervised--desk--128x96")
    ]
    assert [line["masks"] for line in lines] == ["predicted"] * 2 + ["none"] * 2 + ["predicted"] * 2
    assert [line["ari_fg"] for line in lines[:2]] == [line["ari_fg"] for line in lines[4:]]
    for line in lines[:2]:
        assert float(line["ari_fg"]) > 0.9
        assert float(line["miou_bg"]) > 0.9
        assert (frames / "drawn" / f"balls--{line['method']}.png").exists()
    assert "| balls" in capsys.readouterr().out


def test_a_folder_without_frames_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["real_frames", str(tmp_path)]) == EXIT_USAGE
    assert "holds no frames; expected folders with a camera.json each" in capsys.readouterr().err
