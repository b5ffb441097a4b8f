import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from benchmark.ranking.compare import Comparison, compare, comparison_table
from benchmark.ranking.statistics import Difference
from datagen.errors import UsageError
from tests.chosen_scores import failed_row, run_row, save_run, scene_table

N = 50


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Model `a` is 0.05 better than `b` on moving, and they are alike on static; `b` failed on noisy."""
    rng = np.random.default_rng(0)
    for track, gap in (("moving", 0.05), ("static", 0.0)):
        hard = 0.6 + 0.1 * rng.standard_normal(N)
        for model, score in (("a", hard + gap), ("b", hard)):
            for seed in range(2):
                noisy = score + 0.02 * rng.standard_normal(N)
                table = scene_table({"ari_fg": noisy, "msc_fg": noisy, "ari_video": np.full(N, np.nan)})
                save_run(tmp_path, run_row(model, track, seed, n_scenes=N), table)
    save_run(tmp_path, run_row("a", "noisy", n_scenes=N), scene_table({"ari_fg": np.ones(N)}))
    save_run(tmp_path, failed_row("b", "noisy"))
    save_run(tmp_path, run_row("c", "textured", n_scenes=N), scene_table({"ari_fg": np.ones(N)}))
    return tmp_path


def by_place(found: list[Comparison]) -> dict[tuple[str, str], Comparison]:
    return {(line.track, line.metric): line for line in found}


def test_differences_are_paired_by_scene(folder: Path):
    found = by_place(compare(folder, "a", "b"))
    moving, static = found["moving", "msc_fg"], found["static", "msc_fg"]
    assert moving.difference.mean == pytest.approx(0.05, abs=0.01)
    assert moving.difference.low < 0.05 < moving.difference.high
    assert moving.is_significant
    assert moving.difference.resolvable == pytest.approx(2.8 * 0.02 / np.sqrt(N), rel=0.3)
    assert moving.one - moving.two == pytest.approx(moving.difference.mean)
    assert not static.is_significant
    assert static.difference.low < 0 < static.difference.high


def test_only_what_both_have_is_compared(folder: Path):
    found = by_place(compare(folder, "a", "b"))
    assert {track for track, _ in found} == {"moving", "static"}
    assert ("moving", "ari_video") not in found
    assert ("moving", "miou_bg") in found


def test_several_tests_are_corrected_for(folder: Path):
    found = compare(folder, "a", "b", metrics=("ari_fg", "msc_fg"))
    assert all(line.p_corrected >= line.difference.p_value for line in found)
    assert by_place(found)["moving", "ari_fg"].p_corrected == pytest.approx(4 / 10_001)


def test_rows_fitted_elsewhere_are_compared_among_themselves(folder: Path):
    for model in ("a", "b"):
        row = run_row(model, "moving", n_scenes=N, fit_track="mixed", fit_spec="m")
        save_run(folder, row, scene_table({"ari_fg": np.ones(N)}))
    found = compare(folder, "a", "b", metrics=("ari_fg",))
    assert [(line.track, *line.fit_tracks) for line in found] == [
        ("moving", "mixed", "mixed"),
        ("moving", "moving", "moving"),
        ("static", "static", "static"),
    ]
    assert found[0].difference.mean == 0


def test_a_model_fitted_elsewhere_is_compared_with_one_fitted_on_the_track(folder: Path):
    row = run_row("a", "moving", n_scenes=N, fit_track="mixed", fit_spec="m")
    save_run(folder, row, scene_table({"ari_fg": np.ones(N)}))
    (line,) = compare(folder, "a", "b", metrics=("ari_fg",), fit_track="mixed")
    assert (line.track, *line.fit_tracks, line.one) == ("moving", "mixed", "moving", 1)
    assert line.two == by_place(compare(folder, "a", "b"))["moving", "ari_fg"].two
    assert "moving, A fitted on mixed and B on moving, 50 scenes" in printed([line])
    with pytest.raises(UsageError, match="c fitted on static and b on the track itself"):
        compare(folder, "c", "b", fit_track="static")


def printed(found: list[Comparison]) -> str:
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(comparison_table(found, "a", "b"))
    return " ".join(console.export_text().split())


def test_failed_seeds_are_named(folder: Path):
    save_run(folder, run_row("floor", n_scenes=N, kind="floor"), scene_table({"msc_fg": np.full(N, 0.1)}))
    assert "seed" not in printed(compare(folder, "a", "b", metrics=("msc_fg",))).partition("Warning: noisy")[0]
    swapped = scene_table({"msc_fg": np.full(N, 0.6), "miou_bg": np.full(N, 0.1)})
    save_run(folder, run_row("b", seed=2, n_scenes=N), swapped)
    save_run(folder, failed_row("b", seed=3))
    text = printed(compare(folder, "a", "b", metrics=("msc_fg",)))
    assert text.count("Warning: moving: seed 2 of b failed (swap), seed 3 of b failed (out of memory); ") == 1
    assert text.count("Warning: noisy is left out, as b has no scores there: seed 0 of b failed (out of memory).") == 1


def test_a_collapse_that_cannot_be_seen_is_said(folder: Path):
    assert printed(compare(folder, "a", "b", metrics=("msc_fg",))).count("No floor was scored on static") == 1


def difference(mean: float, low: float, high: float, p_value: float = 0.001, resolvable: float = 0.01) -> Difference:
    return Difference(mean, low, high, p_value, win_rate=0.5, resolvable=resolvable, n_scenes=9)


@pytest.mark.parametrize(
    ("found", "corrected", "expected"),
    [
        (difference(0.0003, 0.0002, 0.0004), 0.001, "+0.0003 +0.0002 +0.0004 50 % 0.010 0.001"),
        (difference(-0.00003, -0.00004, -0.00002), 0.001, "-0.00003 -0.00004 -0.00002 50 % 0.010 0.001"),
        (difference(0.012, 0.0004, 0.02), 0.04, "+0.0120 +0.0004 +0.0200 50 % 0.010 0.040"),
        (difference(0.012, 0.0004, 0.02), 0.2, "+0.012 +0.000 +0.020 50 % 0.010 0.200"),
        (difference(-1e-5, -1e-4, 1e-4), 1.0, "+0.000 +0.000 +0.000 50 % 0.010 1.000"),
        (difference(0.1, 0.1, 0.1), 0.0004, "+0.100 +0.100 +0.100 50 % 0.010 <.001"),
        (difference(0.1, 0.1, 0.1), 0.0496, "+0.100 +0.100 +0.100 50 % 0.010 0.0496"),
        (difference(0.1, 0.1, 0.1), 0.0504, "+0.100 +0.100 +0.100 50 % 0.010 0.050"),
        (difference(0.1, 0.1, 0.1, np.nan, np.nan), np.nan, "+0.100 +0.100 +0.100 50 % – –"),
    ],
)
def test_what_is_significant_is_not_printed_as_nothing(found: Difference, corrected: float, expected: str):
    line = Comparison("moving", ("moving", "moving"), "ari", 0.5, 0.4, found, corrected)
    assert f"ari 0.500 0.400 {expected} " in printed([line])


def test_significance_is_five_percent():
    lines = [
        Comparison("m", ("m", "m"), "ari", 0.5, 0.4, difference(0.1, 0.1, 0.1), p)
        for p in (0.0499, 0.05, 0.0999, np.nan)
    ]
    assert [line.is_significant for line in lines] == [True, False, False, False]


def test_names_are_no_markup():
    """Rows may come from anybody."""
    line = Comparison("[red]t", ("[/u]", "[/u]"), "ari", 0.5, 0.4, difference(0.1, 0.1, 0.1), 0.01, ("[/v] failed",))
    console = Console(width=200, record=True, file=io.StringIO(), force_terminal=True)
    console.print(comparison_table([line], "a", "[bold]x[/y]\x1b[2J"))
    text = console.export_text()
    assert "A = a, B = [bold]x[/y]?[2J" in text
    assert "[red]t, fitted on [/u], 9 scenes" in text
    assert "Warning: [/v] failed" in text


def test_two_results_of_one_name_are_refused(folder: Path):
    """Seeds of other settings remain if --overwrite replaces fewer seeds."""
    save_run(folder, run_row("b", "static", 2, n_scenes=N, version=2), scene_table({"ari_fg": np.ones(N)}))
    for pair in (("a", "b"), ("b", "a")):
        with pytest.raises(UsageError, match=r"2 results of 'b' on static, .*: seeds 0, 1 and seeds 2\. Run all seeds"):
            compare(folder, *pair)


def test_a_model_that_is_not_there_is_named(folder: Path):
    with pytest.raises(UsageError, match=r"no scores of 'd'; it has those of: a, b, c"):
        compare(folder, "a", "d")


def test_models_without_a_common_track(folder: Path):
    with pytest.raises(
        UsageError, match=r"a and c have no track in common .* run both on one of moving, noisy, static"
    ):
        compare(folder, "a", "c")
