import pytest

from benchmark.ranking.columns import SCORES
from benchmark.ranking.standings import standings
from benchmark.report.leaderboard_view import details, duration, failures, leaderboard, legend, number
from tests.chosen_scores import failed_row, run_row, scene_table


@pytest.mark.parametrize(
    ("value", "text"), [(-1e-5, "0.000"), (-0.0006, "−0.001"), (0.9996, "1.000"), (float("nan"), "–")]
)
def test_numbers_have_three_decimals_and_no_negative_zero(value: float, text: str):
    assert number(value) == text


def test_models_are_ranked_among_those_of_their_block():
    kinds = {"plane": "classical", "net": "learned", "twin": "learned", "worse": "learned", "kmeans": "classical"}
    scores = {"plane": 0.9, "net": 0.7, "twin": 0.7, "worse": 0.5, "kmeans": 0.6}
    rows = [run_row(name, kind=kind) for name, kind in kinds.items()]
    tables = [scene_table({"ari_fg": [score] * 3, "msc_fg": [score] * 3}) for score in scores.values()]
    found = standings(rows, tables)
    table = leaderboard(found, {name: place for place, name in enumerate(kinds)})
    learned, classical = table["blocks"]
    assert [(row["model"], row["rank"]) for row in learned["rows"]] == [(1, "1.5"), (2, "1.5"), (3, "3")]
    assert [(row["model"], row["rank"]) for row in classical["rows"]] == [(0, "1"), (4, "2")]
    assert learned["rows"][0]["overall"] == "Rank 2.5 of all models on this track"
    notes = " ".join(legend(found, ["1.5"]))
    assert "A rank of 2.5" in notes
    assert "A rank of 2.5" not in " ".join(legend(found, ["1"]))
    assert "A seed failed if" not in notes
    assert "-att in a name:" in " ".join(legend(standings([run_row("net-att")], [tables[0]]), ["1"]))
    assert " in a name:" not in notes
    assert "A seed failed if" in " ".join(legend(standings([run_row("net", status="failed")], [None]), ["1"]))


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
    _, shown = details(standings(rows, [scores[0], scores[0], *scores]), {"once": 0, "two": 1}, SCORES)
    cells = {row["model"]: row["cells"][1]["text"] for row in shown}
    assert cells == {0: "0.500", 1: "0.600 ± 0.100"}


def test_a_model_without_randomness_has_run_once():
    """Its failure, too, is told once."""
    scores = scene_table({"ari_fg": [0.5], "msc_fg": [0.5]})
    chance = [run_row("chance", seed=seed, n_scenes=1) for seed in range(3)]
    broken = [failed_row("broken", seed=seed, random=False) for seed in range(3)]
    results = standings([*chance, *broken], [scores] * 3 + [None] * 3)
    (block,) = leaderboard(results, {"broken": 0, "chance": 1})["blocks"]
    assert {row["model"]: (row["seeds"], row["failure"]) for row in block["rows"]} == {
        0: ("0 of 1", "1 failed (error)"),
        1: ("3", ""),
    }
    assert [failure["name"] for failure in failures(results)] == ["broken, seed 0"]
