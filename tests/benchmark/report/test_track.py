import pytest

from benchmark.ranking.standings import standings
from benchmark.report.track import OWN, TrackResults, comparisons, facts
from tests.chosen_scores import run_row, scene_table


@pytest.mark.parametrize(
    ("names", "first"),
    [
        (["a", "a-density", "b", "b-att"], ["a", "b"]),
        (["a-pretrained", "a-pretrained-density", "a", "b"], ["a-pretrained", "b"]),
        (["a-att", "a", "a-2-slots", "b"], ["a-att", "b"]),
        (["a", "a-att"], ["a", "a-att"]),
        (["a"], ["a", "a"]),
    ],
)
def test_the_page_compares_the_best_rows_of_different_models_first(names: list[str], first: list[str]):
    scores = [scene_table({"ari_fg": [score] * 3, "msc_fg": [score] * 3}) for score in (0.9, 0.8, 0.7, 0.6)]
    results = standings([run_row(name) for name in names], scores[: len(names)])
    track = TrackResults("moving", OWN, tuple(results), None, "no dataset")
    numbers = {name: number for number, name in enumerate(sorted(names))}
    assert [sorted(names)[number] for number in facts(track, numbers)["first"]] == first


def test_differences_are_those_of_the_first_model_from_the_second():
    scores = [scene_table({"msc_fg": [score] * 3}) for score in (0.9, 0.8)]
    results = standings([run_row("a"), run_row("b")], scores)
    track = TrackResults("moving", OWN, tuple(results), None, "no dataset")
    assert comparisons(track, {"a": 7, "b": 3}) == {"7,3": [0.1, 0.1, 0.1, 1.0, 0.0, 3.0]}
