import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from benchmark.ranking.standings import ModelResult, standings
from benchmark.report.learning import PANEL_HEIGHT, PANEL_WIDTH, mean_line, panels, write
from tests.chosen_scores import run_row, scene_table


def curve(*scores: float, minutes: float = 1.0) -> list[dict[str, float]]:
    return [
        {"step": float(i), "seconds": 60 * minutes * i, "loss": 1.0, "ari_fg": score, "msc_fg": score / 2}
        for i, score in enumerate(scores, start=1)
    ]


def results(*, tracks: tuple[str, ...] = ("moving",)) -> list[ModelResult]:
    rows = [
        run_row(model, track, seed, learning_curve=points)
        for track in tracks
        for model, curves in {
            "one": [curve(0.2, 0.4), curve(0.4, 0.8)],
            "two": [curve(-0.1, 1.0, minutes=4.0)],
            "plane": [None],
        }.items()
        for seed, points in enumerate(curves)
    ]
    return standings(rows, [scene_table({"ari_fg": [0.5] * 3})] * len(rows))


def paths(text: str, colour: str) -> list[list[tuple[float, float]]]:
    """Corners of the lines of a colour in panels."""
    root = ET.fromstring(re.sub(r' xmlns="[^"]*"', "", text))
    lines = [path.get("d", "") for path in root.findall("g/path") if path.get("stroke") == colour]
    return [[tuple(map(float, corner.split())) for corner in line[1:].split("L")] for line in lines]  # type: ignore[misc]


def test_all_systems_stand_on_one_axis_of_minutes(tmp_path: Path):
    path = write(tmp_path, results())
    assert path == tmp_path / "learning.svg"
    text = path.read_text()
    first, second = paths(text, "#0072b2"), paths(text, "#d55e00")
    assert len(first) == 2 * 3
    assert len(second) == 2 * 1
    assert second[0] == [(PANEL_WIDTH / 2, PANEL_HEIGHT), (PANEL_WIDTH, 0.0)]
    mean = [(0.125 * PANEL_WIDTH, 0.7 * PANEL_HEIGHT), (0.25 * PANEL_WIDTH, 0.4 * PANEL_HEIGHT)]
    np.testing.assert_allclose(first[2], mean, atol=0.06)
    assert "plane" not in text
    assert text.count("minutes</text>") == 2


def test_every_track_has_its_column(tmp_path: Path):
    path = write(tmp_path, results(tracks=("moving", "static")))
    assert path
    text = path.read_text()
    assert [text.count(f">{track}: ") for track in ("moving", "static")] == [2, 2]


def test_seeds_are_averaged_as_far_as_all_of_them_go():
    one = np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.2, 0.4])
    two = np.array([0.5, 2.5]), np.array([0.5, 0.5])
    minutes, scores = mean_line([one, two])
    assert minutes.tolist() == [1.0, 2.0, 2.5]
    np.testing.assert_allclose(scores, [0.25, 0.35, 0.4])


def test_undefined_scores_are_left_out():
    row = run_row("one", learning_curve=curve(0.2, float("nan"), 0.6))
    (panel, _) = panels(standings([row], [scene_table({"ari_fg": [0.5] * 3})]))
    ((minutes, _),) = panel.lines["one"]
    assert minutes.tolist() == [1.0, 3.0]


def test_without_curves_there_is_no_drawing(tmp_path: Path):
    (tmp_path / "learning.svg").write_text("of other rows")
    rows = [run_row("one", learning_curve=[{"step": 1.0, "loss": 2.0}]), run_row("plane", kind="classical")]
    assert write(tmp_path, standings(rows, [scene_table({"ari_fg": [0.5] * 3})] * 2)) is None
    assert not (tmp_path / "learning.svg").exists()
