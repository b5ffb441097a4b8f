from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.ranking.standings import (
    RANKED_METRICS,
    SWITCHES,
    ModelResult,
    comparable_groups,
    compare_results,
    letters_of_groups,
    load_standings,
    standings,
)
from benchmark.results.run_folder import RunRow, SceneTable
from datagen.errors import CorruptFile
from tests.chosen_scores import failed_row, run_row, save_run, scene_table

N = 40
NOISE = np.random.default_rng(0).normal(0, 0.05, N)


def scored(
    model: str, score: float, seed: int = 0, noise: np.ndarray = NOISE, **changes: Any
) -> tuple[RunRow, SceneTable]:
    """A run whose ARI-FG and MSC-FG scatter about one score in the same way for every model."""
    values = score + noise
    return run_row(model, seed=seed, n_scenes=N, **changes), scene_table({"ari_fg": values, "msc_fg": values})


def results_of(*pairs: tuple[RunRow, SceneTable | None]) -> dict[str, ModelResult]:
    rows, tables = zip(*pairs, strict=True)
    return {result.place[2]: result for result in standings(rows, tables)}


def test_seeds_come_together():
    result = results_of(*(scored("m", 0.5 + 0.1 * seed, seed) for seed in (2, 0, 1)))["m"]
    assert [row.key.seed for row in result.rows] == [0, 1, 2]
    assert result.seed_means("msc_fg") == pytest.approx(np.array([0.5, 0.6, 0.7]) + NOISE.mean())
    summary = result.summary("msc_fg")
    assert summary.mean == pytest.approx(0.6 + NOISE.mean())
    assert summary.std == pytest.approx(0.1 * np.sqrt(2 / 3))
    assert summary.sample_std == pytest.approx(0.1)
    assert summary.low < 0.55 < 0.65 < summary.high


def test_a_method_without_randomness_has_no_spread():
    """Its row is repeated for each seed, and only scenes are resampled."""
    once = results_of(scored("m", 0.5, random=False))["m"].summary("msc_fg")
    thrice = results_of(*(scored("m", 0.5, seed, random=False) for seed in range(3)))["m"].summary("msc_fg")
    assert (thrice.mean, thrice.std, thrice.sample_std) == (once.mean, 0, 0)
    assert (thrice.low, thrice.high) == (once.low, once.high)


def test_label_maps_made_elsewhere_are_seeds_of_one_entry():
    """The digests of their contents, background slots included, stand in the place of settings."""
    pairs = [scored("mine", 0.5 + 0.1 * seed, seed, kind="predictions", config_hash=f"c{seed}") for seed in range(3)]
    rows, tables = zip(*pairs, strict=True)
    (result,) = standings(rows, tables)
    assert [row.key.seed for row in result.rows] == [0, 1, 2]
    assert result.summary("msc_fg").sample_std == pytest.approx(0.1)
    models = [scored("net", 0.5, seed, config_hash=f"c{seed}") for seed in range(2)]
    assert len(standings(*zip(*models, strict=True))) == 2


def test_models_are_ranked_by_both_metrics():
    """A model that is best in one metric and worst in the other loses to one that is second in both."""
    pairs = []
    for name, ari_fg, msc_fg in (("leaky", 0.99, 0.3), ("good", 0.9, 0.9), ("fair", 0.8, 0.8)):
        table = scene_table({"ari_fg": np.full(N, ari_fg), "msc_fg": np.full(N, msc_fg)})
        pairs.append((run_row(name, n_scenes=N), table))
    results = results_of(*pairs)
    assert [(results[name].rank, results[name].mean_rank) for name in ("good", "leaky", "fair")] == [
        (1, 1.5),
        (2, 2.0),
        (3, 2.5),
    ]


def test_floors_oracles_and_label_users_are_never_ranked():
    kinds: Mapping[str, dict[str, Any]] = {
        "floor": {"kind": "floor"},
        "oracle": {"kind": "oracle", "uses_labels": True},
        "supervised": {"uses_labels": True},
        "given": {"kind": "predictions"},
        "classical": {"kind": "classical", "tuned": True, "trials": 12},
        "uncounted": {"kind": "classical", "tuned": True},
    }
    results = results_of(*(scored(name, 0.2 if name == "floor" else 0.5, **kinds[name]) for name in kinds))
    assert {name for name, result in results.items() if result.rank} == {"given", "classical", "uncounted"}
    assert {name: result.marks for name, result in results.items()} == {
        "floor": "",
        "oracle": "†",
        "supervised": "†",
        "given": "",
        "classical": "‡12",
        "uncounted": "‡",
    }


def test_the_mark_of_tuning_stays_if_the_first_seed_failed():
    """A failed run records neither tuning nor trials."""
    tuned = [scored("m", 0.5, seed, tuned=True, trials=12) for seed in (1, 2)]
    assert results_of((failed_row("m"), None), *tuned)["m"].marks == "‡12"


def test_equal_models_share_the_mean_of_their_places():
    """Exactly equal ones, and those of which one leads in ARI-FG and the other in MSC-FG by as much."""
    found = results_of(scored("best", 0.9), scored("a", 0.8), scored("b", 0.8), scored("last", 0.7))
    assert {name: result.rank for name, result in found.items()} == {"best": 1, "a": 2.5, "b": 2.5, "last": 4}
    crossed = {"one": (0.9, 0.8), "two": (0.8, 0.9)}
    tables = [scene_table(dict(zip(RANKED_METRICS, np.tile(pair, (N, 1)).T, strict=True))) for pair in crossed.values()]
    found = standings([run_row(name, n_scenes=N) for name in crossed], tables)
    assert [result.rank for result in found] == [1.5, 1.5]


def test_a_model_whose_every_seed_failed_is_not_ranked():
    floor, fine = scored("floor", 0.2, kind="floor"), scored("fine", 0.6)
    swapped, table = scored("swapped", 0.9)
    half = [scored("half", 0.7), (failed_row("half", seed=1), None)]
    results = results_of(floor, fine, (swapped, table | {"miou_bg": np.full(N, 0.1)}), scored("flat", 0.22), *half)
    assert {name: result.rank for name, result in results.items()} == {
        "floor": None,
        "fine": 2,
        "swapped": None,
        "flat": None,
        "half": 1,
    }
    assert (results["half"].n_scored, results["swapped"].n_scored, results["swapped"].n_failed) == (1, 1, 1)


def test_the_bar_is_known_only_where_a_floor_has_scores():
    low, high = (scored(name, score, kind="floor") for name, score in (("low", 0.1), ("high", 0.2)))
    lost = (failed_row("low", "static", kind="floor", track_spec="s"), None)
    elsewhere = scored("m", 0.8, track="static", track_spec="s")
    moving = results_of(low, high, scored("m", 0.8))["m"]
    assert moving.best_floor == pytest.approx(0.2 + NOISE.mean())
    assert np.isnan(results_of(lost, elsewhere, low)["m"].best_floor)


def test_identity_switches_are_summarised_like_metrics():
    """A mean over the scenes that have time; stills have none."""
    row, table = scored("m", 0.5)
    pairs = [(run_row("m", seed=s, n_scenes=N), table | {"identity_switches": np.full(N, 1.0 + s)}) for s in range(2)]
    result = results_of(*pairs)["m"]
    assert result.seed_means(SWITCHES).tolist() == [1.0, 2.0]
    assert (result.summary(SWITCHES).mean, result.summary(SWITCHES).std) == (1.5, 0.5)
    stills = results_of((row, table | {"ari_video": np.full(N, np.nan), "ari_video_n": np.zeros(N)}))["m"]
    assert np.isnan(stills.summary(SWITCHES).mean)


def test_ties_are_found_by_pairing():
    """Scores scatter by 0.05 over scenes; 0.01 of constant advantage is certain, 0.01 within the scatter is not."""
    scatter = np.random.default_rng(1).normal(0, 0.1, N)
    results = results_of(
        scored("best", 0.90), scored("second", 0.89), scored("loose", 0.895, noise=NOISE + scatter - scatter.mean())
    )
    groups = {name: set(result.group_letters[1]) for name, result in results.items()}
    assert not groups["best"] & groups["second"]
    assert groups["loose"] & groups["best"]
    assert groups["loose"] & groups["second"]
    assert "a" in groups["best"]


def pair_that_differs(errors: float) -> list[tuple[RunRow, SceneTable]]:
    """Two models whose paired difference is so many of its standard errors."""
    scatter = np.random.default_rng(2).normal(size=N)
    scatter = 0.01 * (scatter - scatter.mean()) / scatter.std()
    return [scored("one", 0.5, noise=NOISE), scored("two", 0.5, noise=NOISE + scatter + errors * 0.01 / np.sqrt(N))]


@pytest.mark.parametrize(("errors", "together"), [(1.8, True), (2.1, False)])
def test_models_share_a_letter_unless_they_differ_at_five_percent(errors: float, together: bool):
    """1.8 standard errors are found by chance in about 7 % of all samples of scenes, 2.1 in about 4 %."""
    results = results_of(*pair_that_differs(errors))
    p_value = compare_results(results["one"], results["two"], "msc_fg").p_value
    assert 0.05 < p_value < 0.1 if together else 0.025 < p_value < 0.05
    expected = ("a", "a") if together else ("b", "a")
    assert (results["one"].group_letters, results["two"].group_letters) == ((expected[0],) * 2, (expected[1],) * 2)


def test_each_ranked_metric_has_letters_of_its_own():
    tables = [scene_table({"ari_fg": np.full(N, 0.5), "msc_fg": np.full(N, score)}) for score in (0.9, 0.8)]
    one, two = standings([run_row(name, n_scenes=N) for name in ("one", "two")], tables)
    assert (one.group_letters, two.group_letters) == (("a", "a"), ("a", "b"))


def test_there_are_letters_for_any_number_of_groups():
    values = np.random.default_rng(3).permutation(28) / 28
    letters = letters_of_groups(~np.eye(28, dtype=bool), values)
    assert len(set(letters)) == 28
    best_first = [letters[place] for place in np.argsort(-values)]
    assert (best_first[0], best_first[25:]) == ("a", ["z", "a'", "b'"])


def test_letters_are_corrected_for_the_number_of_pairs():
    """A difference that is significant between two models is not, where four more make it one of fifteen."""
    more = [scored(f"more-{place}", 0.5, noise=NOISE) for place in range(4)]
    results = results_of(*pair_that_differs(2.1), *more)
    assert {result.group_letters for result in results.values()} == {("a", "a")}


def test_failed_seeds_are_named_and_can_be_left_out():
    fine, floor = scored("m", 0.8, 0), scored("floor", 0.2, kind="floor")
    swapped, table = scored("m", 0.8, 1)
    collapsed = scored("m", 0.24, 2)
    exploded = scored("m", 0.8, 3, learning_curve=[{"step": 1.0, "loss": float("nan")}])
    pairs = (
        fine,
        (swapped, table | {"miou_bg": np.full(N, 0.1)}),
        collapsed,
        exploded,
        (failed_row("m", seed=4), None),
    )
    result = results_of(*pairs, floor)["m"]
    assert result.causes == ("", "swap", "collapse", "nan", "out of memory")
    assert result.n_failed == 4
    assert result.summary("msc_fg").mean == pytest.approx((3 * 0.8 + 0.24) / 4 + NOISE.mean())
    assert result.summary("msc_fg", without_failed=True).mean == pytest.approx(0.8 + NOISE.mean())


def test_the_rule_is_the_same_for_all_that_compete():
    kinds = {"classical": "classical", "learned": "learned", "given": "predictions"}
    floors = [scored(name, score, kind="floor") for name, score in (("low", 0.05), ("high", 0.2))]
    oracle = scored("oracle", 0.22, kind="oracle")
    results = results_of(*(scored(name, 0.22, kind=kind) for name, kind in kinds.items()), oracle, *floors)
    assert {results[name].causes for name in kinds} == {("collapse",)}
    assert {results[name].causes for name in ("low", "high", "oracle")} == {("",)}


def test_a_model_that_only_failed_has_no_scores():
    result = results_of((failed_row("m"), None), scored("other", 0.5))["m"]
    assert np.isnan(result.summary("msc_fg").mean)
    assert result.rank is None
    assert (result.n_scenes, result.n_skipped, result.n_failed) == (0, 0, 1)


def test_models_fitted_elsewhere_have_a_field_of_their_own():
    pairs = [
        scored("a", 0.5),
        scored("b", 0.6),
        scored("a", 0.7, fit_track="mixed", fit_spec="mm"),
        scored("c", 0.7, track_spec="other data"),
    ]
    rows, tables = zip(*pairs, strict=True)
    found = [[(result.place, result.rank) for result in group] for group in comparable_groups(standings(rows, tables))]
    assert found == [
        [(("moving", "moving", "a"), 2), (("moving", "moving", "b"), 1)],
        [(("moving", "mixed", "a"), 1)],
        [(("moving", "moving", "c"), 1)],
    ]


def test_scenes_without_objects_are_counted_as_skipped():
    scores = [0.5, np.nan, 0.7]
    result = results_of((run_row("m"), scene_table({"ari_fg": scores, "msc_fg": scores})))["m"]
    assert result.n_skipped == 1
    assert results_of((run_row("m"), scene_table({"ari_fg": scores, "msc_fg": [0.5] * 3})))["m"].n_skipped == 0
    assert result.summary("msc_fg").mean == pytest.approx(0.6)
    assert result.summary("ari").mean == pytest.approx(0.9)


def test_rows_of_one_dataset_have_equally_many_scenes(tmp_path: Path):
    """Else scenes could not be paired."""
    save_run(tmp_path, run_row("a"), scene_table({"ari_fg": [0.5] * 3}))
    save_run(tmp_path, run_row("b", n_scenes=2), scene_table({"ari_fg": [0.5] * 2}))
    save_run(tmp_path, run_row("c", "static", n_scenes=4, track_spec="s"), scene_table({"ari_fg": [0.5] * 4}))
    save_run(tmp_path, failed_row("d"))
    with pytest.raises(CorruptFile, match=r"has 2 scenes in the row moving--b--\S+ and 3 in moving--a--\S+"):
        load_standings(tmp_path)


def test_progress_is_shown_for_what_takes_long(tmp_path: Path):
    for model in ("a", "b"):
        save_run(tmp_path, run_row(model), scene_table({"ari_fg": [0.5] * 3}))
    heard: list[tuple[str, int]] = []

    def progress(items: Sequence[Any], title: str) -> Sequence[Any]:
        heard.append((title, len(items)))
        return items

    load_standings(tmp_path, progress)
    assert heard == [("reading scores", 2), ("ranking models", 1)]


def test_the_spread_of_one_run_is_unknown():
    results = results_of(
        *(scored("fixed", 0.5, seed, random=False) for seed in range(3)),
        scored("half", 0.5),
        (failed_row("half", seed=1), None),
        *(scored("two", 0.5 + 0.2 * seed, seed) for seed in range(2)),
    )
    mean = 0.5 + NOISE.mean()
    assert results["fixed"].score("msc_fg") == (pytest.approx(mean), pytest.approx(np.nan, nan_ok=True))
    assert results["half"].score("msc_fg") == (pytest.approx(mean), pytest.approx(np.nan, nan_ok=True))
    assert results["two"].score("msc_fg") == pytest.approx((mean + 0.1, 0.1))
