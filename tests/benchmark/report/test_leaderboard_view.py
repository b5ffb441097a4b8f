import pytest

from benchmark.ranking.standings import standings
from benchmark.report.leaderboard_view import blocks, details, duration, failures, number
from tests.chosen_scores import failed_row, run_row, scene_table


@pytest.mark.parametrize(
    ("value", "text"), [(-1e-5, "0.000"), (-0.0006, "−0.001"), (0.9996, "1.000"), (float("nan"), "–")]
)
def test_numbers_have_three_decimals_and_no_negative_zero(value: float, text: str):
    assert number(value) == text


def test_the_best_without_training_stands_among_those_that_learn_by_rank():
    scores = {"plane": 0.9, "kmeans": 0.4, "net": 0.5}
    kinds = {"plane": "classical", "kmeans": "classical", "net": "learned"}
    rows = [run_row(name, kind=kinds[name], views="1 in, 3 supervise" if name == "net" else "") for name in scores]
    tables = [scene_table({"ari_fg": [score] * 3, "msc_fg": [score] * 3}) for score in scores.values()]
    classical, learned = blocks(standings(rows, tables), {name: place for place, name in enumerate(scores)})
    assert [(row.model, row.repeated, row.views) for row in learned.rows] == [
        (0, True, ""),
        (2, False, "1 in, 3 supervise"),
    ]
    assert [(row.model, row.repeated) for row in classical.rows] == [(0, False), (1, False)]
    (alone,) = blocks(standings(rows[2:], tables[2:]), {"net": 0})
    assert [row.repeated for row in alone.rows] == [False]


@pytest.mark.parametrize(
    ("seconds", "text"), [(1374.2, "1374 s"), (0.5, "500 ms"), (2e-5, "20 µs"), (0.0, "–"), (float("nan"), "–")]
)
def test_times_have_units_and_no_exponents(seconds: float, text: str):
    assert duration(seconds) == text


def test_a_single_run_has_no_deviation():
    scores = [scene_table({"ari_fg": [score] * 3, "msc_fg": [score] * 3}) for score in (0.5, 0.7)]
    rows = [run_row("once", seed=seed, random=False) for seed in range(2)] + [
        run_row("two", seed=seed) for seed in range(2)
    ]
    _, shown = details(standings(rows, [scores[0], scores[0], *scores]), {"once": 0, "two": 1})
    cells = {row["model"]: row["cells"][1] for row in shown}
    assert cells == {0: "0.500", 1: "0.600 ± 0.100"}


def test_a_model_without_randomness_has_run_once():
    """Its failure, too, is told once."""
    scores = scene_table({"ari_fg": [0.5], "msc_fg": [0.5]})
    chance = [run_row("chance", seed=seed, n_scenes=1) for seed in range(3)]
    broken = [failed_row("broken", seed=seed, random=False) for seed in range(3)]
    entries = standings([*chance, *broken], [scores] * 3 + [None] * 3)
    (block,) = blocks(entries, {"broken": 0, "chance": 1})
    assert {row.model: (row.seeds, row.failure) for row in block.rows} == {
        0: ("0 of 1", "1 failed (error)"),
        1: ("3", ""),
    }
    assert [failure["name"] for failure in failures(entries)] == ["broken, seed 0"]
