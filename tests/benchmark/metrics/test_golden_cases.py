"""Golden cases: small label maps with the values that the metrics' reference implementations give."""

from collections import Counter
from typing import Any

import numpy as np
import pytest

from benchmark.commands.selftest import checks, golden, label_maps
from benchmark.metrics import CLIP_METRICS, METRICS, OTHER_METRICS, clip_scores, score

CASES = {case["name"]: case for case in golden()["cases"]}
VIDEOS = [case for case in CASES.values() if case["kind"] == "video"]


@pytest.mark.parametrize("case", CASES.values(), ids=lambda case: case["name"])
def test_every_metric_of_the_case(case: dict[str, Any]):
    found = list(checks(case))
    assert found
    assert [str(check) for check in found if not check.passed] == []


def test_the_file_is_whole():
    assert len(CASES) == golden()["n_cases"] == 41
    kinds = Counter(case["kind"] for case in CASES.values())
    assert kinds == {"image": 30, "soft": 2, "video": 5, "procedural": 2, "image-ignore": 1, "batch": 1}


@pytest.mark.parametrize("case", [case for case in CASES.values() if case["kind"] in ("image", "soft")])
def test_images_check_all_frame_metrics(case: dict[str, Any]):
    assert set(METRICS) <= {check.metric for check in checks(case)}


@pytest.mark.parametrize("case", VIDEOS)
def test_videos_check_all_clip_metrics(case: dict[str, Any]):
    assert {*CLIP_METRICS, *OTHER_METRICS} <= {check.metric for check in checks(case)}


def test_ignored_pixels_are_counted():
    truth, prediction = label_maps(CASES["ignore_label_minus1"])
    assert score(truth, prediction, ignore=truth < 0)["n_ignored"] == 2


def test_images_without_objects_are_counted():
    scores = score(*label_maps(CASES["batch_with_empty_image"]))
    assert scores["msc_fg"] == 1.0
    assert scores["n_undefined"] == 1


def test_frames_of_the_id_switch_are_perfect_by_themselves():
    assert score(*label_maps(CASES["v_id_switch_half"]))["ari_fg"] == 1.0


@pytest.mark.parametrize(
    ("name", "switches"),
    [("v_perfect", 0), ("v_id_switch_half", 2), ("v_constant_merge", 0), ("v_one_object_per_frame", 1)],
)
def test_identity_switches_of_the_videos(name: str, switches: int):
    assert score(*label_maps(CASES[name]))["identity_switches"] == switches


@pytest.mark.parametrize("case", VIDEOS)
def test_views_are_no_time(case: dict[str, Any]):
    """Two videos side by side as views score as each does by itself."""
    truth, prediction = label_maps(case)
    both = clip_scores(*(np.stack([maps, maps[::-1]], axis=1) for maps in (truth, prediction)))
    for view, step in enumerate((1, -1)):
        alone = score(truth[::step], prediction[::step])
        for name in CLIP_METRICS:
            assert both[name][view] == alone[name]
        assert both["identity_switches"][view] == alone["identity_switches"]
        frames = clip_scores(truth[::step, None], prediction[::step, None])
        for name in METRICS:
            np.testing.assert_array_equal(both[name][view::2], frames[name])
