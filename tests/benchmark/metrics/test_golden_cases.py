"""Golden cases: small label maps with the values that the metrics' reference implementations give."""

import fnmatch
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.metrics import METRICS, frame_scores, score

GOLDEN = json.loads((Path(__file__).parent.parent / "data" / "metric_cases.json").read_text())
TOLERANCE = GOLDEN["tolerance"]
CASES = {case["name"]: case for case in GOLDEN["cases"]}
IMAGES = [case for case in CASES.values() if case["kind"] in ("image", "soft")]
VIDEOS = [case for case in CASES.values() if case["kind"] == "video"]
PROCEDURAL = [case for case in CASES.values() if case["kind"] == "procedural"]


def maps(case: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    truth, prediction = np.array(case["gt"]), np.array(case["pred"])
    return (truth[None], prediction[None]) if truth.ndim == 2 else (truth, prediction)


def is_undefined(case: dict[str, Any], metric: str) -> bool:
    """Whether the recommended policy makes the metric nan, whatever the reference gives."""
    policies = case.get("recommended_policy", {}).items()
    return any(
        "undefined" in policy and fnmatch.fnmatch(metric, pattern)
        for patterns, policy in policies
        for pattern in patterns.split(",")
    )


@pytest.mark.parametrize("case", IMAGES, ids=lambda case: case["name"])
def test_images(case: dict[str, Any]):
    scores = score(*maps(case))
    for metric in METRICS:
        expected = math.nan if is_undefined(case, metric) else case["metrics"][metric]["expected"]
        assert scores[metric] == pytest.approx(expected, abs=TOLERANCE, nan_ok=True), metric


@pytest.mark.parametrize("case", VIDEOS, ids=lambda case: case["name"])
def test_means_over_the_frames_of_videos(case: dict[str, Any]):
    scores = score(*maps(case))
    leaves_out_frames = "*_frame_mean (fg)" in case.get("recommended_policy", {})
    for name, value in case["metrics"].items():
        metric = name.removesuffix("_frame_mean")
        if name != metric and metric in METRICS:
            expected = 1.0 if leaves_out_frames and "fg" in metric else value["expected"]
            assert scores[metric] == pytest.approx(expected, abs=TOLERANCE), metric


@pytest.mark.parametrize("case", PROCEDURAL, ids=lambda case: case["name"])
def test_many_points(case: dict[str, Any]):
    frames, height, width = (case["rule"][axis] for axis in "THW")
    y, x = np.mgrid[:height, :width]
    image = np.where((y * 8 // height + x * 8 // width) % 3 == 0, 0, 1 + (y * 2 // height) * 2 + x * 2 // width)
    shift = 5 if frames == 1 else 11
    assert f"np.roll(gt, {shift}, axis=2)" in case["rule"]["pred"]
    truth = np.broadcast_to(image, (frames, height, width))
    stacked = truth.reshape(1, -1, width), np.roll(truth, shift, axis=2).reshape(1, -1, width)
    scores = score(*stacked)
    assert scores["ari"] == pytest.approx(case["metrics"]["ari_video"]["expected"], abs=TOLERANCE)
    assert scores["ari_fg"] == pytest.approx(case["metrics"]["ari_fg_video"]["expected"], abs=TOLERANCE)


def test_ignored_pixels():
    case = CASES["ignore_label_minus1"]
    truth, prediction = maps(case)
    scores = score(truth, prediction, ignore=truth < 0)
    for metric in set(METRICS) & set(case["metrics"]):
        assert scores[metric] == pytest.approx(case["metrics"][metric]["expected"], abs=TOLERANCE), metric
    assert scores["n_ignored"] == 2


def test_images_without_objects_are_left_out_of_the_mean():
    scores = score(*maps(CASES["batch_with_empty_image"]))
    assert scores["msc_fg"] == 1.0
    assert scores["n_undefined"] == 1


def test_the_file_is_whole():
    assert len(CASES) == GOLDEN["n_cases"] or len(CASES) == 41
    assert (len(IMAGES), len(VIDEOS), len(PROCEDURAL)) == (32, 5, 2)


def test_frames_of_the_id_switch_are_perfect_by_themselves():
    frames = frame_scores(*maps(CASES["v_id_switch_half"]))
    assert np.all(frames["ari_fg"] == 1.0)
