from benchmark.ranking.standings import Entry, standings
from benchmark.ranking.table_text import run_once, seeds_in_words
from tests.chosen_scores import failed_row


def entries(**seeds: int) -> list[Entry]:
    """Models with that many seeds; those named `fixed` have no randomness."""
    rows = [
        failed_row(name, seed=seed, random=not name.startswith("fixed"))
        for name, n in seeds.items()
        for seed in range(n)
    ]
    return standings(rows, [None] * len(rows))


def test_seeds_are_counted_where_they_make_a_difference():
    assert seeds_in_words(entries(a=3, fixed=5)) == "3 seeds"
    assert seeds_in_words(entries(a=1)) == "1 seed"
    assert seeds_in_words(entries(a=3, b=1, c=2)) == "1 to 3 seeds"
    assert seeds_in_words(entries(fixed=3)) == ""


def test_models_that_were_run_once_for_several_seeds_are_named():
    assert run_once(entries(fixed_b=2, fixed_a=3, a=3)) == "fixed_a, fixed_b"
    assert run_once(entries(fixed=1, a=1)) == ""
