"""`obpose-bench selftest`: compare the metrics with reference implementations on golden cases, small label maps."""

import fnmatch
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from benchmark.metrics import score

Case = Mapping[str, Any]

SUFFIXES = ("_frame_mean", "_batch_mean")
"""Suffixes of metric names in the cases that mean an average over frames; our metrics always average."""


WITHOUT_EMPTY_FRAMES = {"v_bg_only_frame": 1.0, "batch_with_empty_image": 1.0}
"""Expected foreground means of cases that leave out frames without objects; references score such frames 0 or 1."""


@dataclass(frozen=True)
class Check:
    """One metric of one case."""

    case: str
    metric: str
    expected: float
    """Expected value; nan if the metric should be undefined."""
    found: float
    tolerance: float

    @property
    def passed(self) -> bool:
        """Whether the two agree."""
        both_undefined = math.isnan(self.expected) and math.isnan(self.found)
        return both_undefined or abs(self.found - self.expected) <= self.tolerance

    def __str__(self) -> str:
        return f"{self.case}: {self.metric} is {self.found:.7f}, expected {self.expected:.7f}"


def run(score: Callable[..., dict[str, float]] = score) -> list[str]:
    """Check the metrics `score` on all golden cases; returns one line per deviation, so an empty list is success."""
    return [str(check) for case in golden()["cases"] for check in checks(case, score) if not check.passed]


@cache
def golden() -> Mapping[str, Any]:
    """Load the golden cases: `cases`, their `tolerance`, and `published_per_seed` of the paper's authors."""
    return json.loads((files("benchmark.metrics") / "golden_cases.json").read_text(encoding="utf-8"))


def checks(case: Case, score: Callable[..., dict[str, float]] = score) -> Iterator[Check]:
    """Check every metric that both the case and `score` have."""
    truth, prediction = label_maps(case)
    ignore = truth < 0
    scores = score(truth, prediction, ignore=ignore if ignore.any() else None)
    for name, entry in case["metrics"].items():
        metric = _plain_name(name)
        if metric in scores:
            expected = _expected(case, name, entry) if np.any(truth == 0) else _without_background(case, name, entry)
            yield Check(case["name"], name, expected, scores[metric], golden()["tolerance"])


def label_maps(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Ground truth and prediction, each (frame, height, width); negative labels of the truth are ignored."""
    if "rule" in case:
        return _by_rule(case["rule"])
    truth, prediction = np.array(case["gt"]), np.array(case["pred"])
    return (truth[None], prediction[None]) if truth.ndim == 2 else (truth, prediction)


def _by_rule(rule: Case) -> tuple[np.ndarray, np.ndarray]:
    """Build large maps: a board of four objects and a background, and a copy rolled along x."""
    frames, height, width = (rule[axis] for axis in "THW")
    y, x = np.mgrid[:height, :width]
    image = np.where((y * 8 // height + x * 8 // width) % 3 == 0, 0, 1 + (y * 2 // height) * 2 + x * 2 // width)
    shift = int(rule["pred"].partition("rolled by ")[2].partition(" ")[0])
    truth = np.broadcast_to(image, (frames, height, width))
    return truth, np.roll(truth, shift, axis=2)


def _plain_name(name: str) -> str:
    for suffix in SUFFIXES:
        name = name.removesuffix(suffix)
    return name


def _without_background(case: Case, name: str, entry: Case) -> float:
    """Expected value without background pixels: references score an undefined overlap as 0, and remove a slot."""
    if name == "miou_bg_oracle":
        return math.nan
    if name == "msc_fg_oracle_bg":
        return case["metrics"]["msc_fg_allslots"]["expected"]
    return _expected(case, name, entry)


def _expected(case: Case, name: str, entry: Case) -> float:
    """Expected value by the recommended policy; without a policy, the reference's value."""
    if case["name"] in WITHOUT_EMPTY_FRAMES and "fg" in name and name != _plain_name(name):
        return WITHOUT_EMPTY_FRAMES[case["name"]]
    for names, policy in case.get("recommended_policy", {}).items():
        undefined = policy.startswith("undefined")
        if undefined and any(fnmatch.fnmatch(name, pattern) for pattern in names.split(",")):
            return math.nan
    return entry["expected"]
