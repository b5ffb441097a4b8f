import pytest

from benchmark.report.board import blocks, failures, number
from benchmark.standings import standings
from tests.chosen_scores import failed_row, run_row, scene_table


@pytest.mark.parametrize(
    ("value", "text"), [(-1e-5, "0.000"), (-0.0006, "−0.001"), (0.9996, "1.000"), (float("nan"), "–")]
)
def test_numbers_have_three_decimals_and_no_negative_zero(value: float, text: str):
    assert number(value) == text


def test_the_best_without_training_stands_above_those_that_learn():
    scores = {"plane": 0.9, "kmeans": 0.4, "net": 0.5}
    kinds = {"plane": "classical", "kmeans": "classical", "net": "learned"}
    rows = [run_row(name, kind=kinds[name], views="1 in, 3 supervise" if name == "net" else "") for name in scores]
    tables = [scene_table({"ari_fg": [score] * 3, "msc_fg": [score] * 3}) for score in scores.values()]
    learned, classical = blocks(standings(rows, tables), {name: place for place, name in enumerate(scores)})
    assert [(row.model, row.repeated, row.views) for row in learned.rows] == [
        (0, True, ""),
        (2, False, "1 in, 3 supervise"),
    ]
    assert [(row.model, row.repeated) for row in classical.rows] == [(0, False), (1, False)]
    (alone,) = blocks(standings(rows[2:], tables[2:]), {"net": 0})
    assert [row.repeated for row in alone.rows] == [False]


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
