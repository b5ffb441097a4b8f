from typing import Any

import numpy as np
import pytest

from benchmark.commands.selftest import golden
from benchmark.ranking.columns import (
    MAIN_SCORES,
    SCORES,
    Row,
    blocks,
    caveats,
    group_letters,
    marks_explained,
    mean_and_std,
    paper_of_track,
    paper_scores,
    scenes_title,
    seeds_in_words,
    suffixes_explained,
    table_notes,
    track_title,
)
from benchmark.ranking.standings import ModelResult, standings
from tests.chosen_scores import failed_row, run_row, scene_table

ONES = scene_table({"ari_fg": [1.0] * 3, "msc_fg": [1.0] * 3})


def results(**models: dict[str, Any]) -> list[ModelResult]:
    """Models with perfect scores; the values are fields of their rows."""
    return standings([run_row(name, **facts) for name, facts in models.items()], [ONES] * len(models))


def scored(**models: tuple[str, float]) -> list[ModelResult]:
    """Models by name: kind and score."""
    rows = [run_row(name, kind=kind, uses_labels=kind == "oracle") for name, (kind, _) in models.items()]
    tables = [scene_table({"ari_fg": [score] * 3, "msc_fg": [score] * 3}) for _, score in models.values()]
    return standings(rows, tables)


def rows_of(found: list[ModelResult]) -> dict[str, Row]:
    return {row.label: row for block in blocks(found) for row in block.rows}


def test_learned_models_come_first_and_baselines_have_blocks_of_their_own():
    found = scored(
        truth=("oracle", 0.99),
        floor=("floor", 0.1),
        plane=("classical", 0.9),
        bad=("learned", 0.5),
        net=("learned", 0.8),
    )
    assert [(block.kind, [row.label for row in block.rows]) for block in blocks(found)] == [
        ("learned", ["net", "bad"]),
        ("classical", ["plane"]),
        ("floor", ["floor"]),
        ("oracle", ["truth †"]),
    ]
    assert [row.rank for row in rows_of(found).values()] == ["2", "3", "1", "", ""]


def test_a_model_that_learned_from_labels_has_a_block_of_its_own_and_no_rank():
    (_, block) = blocks(results(plane={"kind": "classical"}, supervised={"uses_labels": True}))
    assert (block.kind, block.rows[0].label, block.rows[0].rank) == ("labels", "supervised †", "")


def test_failed_seeds_are_left_out_in_a_row_of_their_own():
    swapped = scene_table({"msc_fg": [0.9] * 3, "miou_bg": [0.1] * 3})
    rows = [run_row(), run_row(seed=1), failed_row(seed=2)]
    found = rows_of(standings(rows, [scene_table({"msc_fg": [0.5] * 3}), swapped, None]))
    label = "– without the 2 failed of 3 seeds (swap, out of memory)"
    assert list(found) == ["m", label]
    assert (found["m"].seeds, found[label].seeds) == ("2 of 3", "1 of 3")
    msc_fg = next(score for score in SCORES if score.name == "msc_fg")
    assert (msc_fg.cell(found["m"]), msc_fg.cell(found[label])) == ("0.70±0.20", "0.50")
    assert (group_letters(found["m"], msc_fg), group_letters(found[label], msc_fg)) == ("a", "")


@pytest.mark.parametrize(
    ("mean", "std", "text"),
    [
        (-0.001, 0.0, "0.00±0.00"),
        (-0.01, 0.0, "-0.01±0.00"),
        (0.976, 0.0009, "0.98±0.00"),
        (0.5, np.nan, "0.50"),
        (np.nan, np.nan, "–"),
    ],
)
def test_scores_are_printed_as_in_the_paper(mean: float, std: float, text: str):
    assert mean_and_std(mean, std) == text


def test_seeds_are_counted_where_they_make_a_difference():
    def seeds(**numbers: int) -> str:
        names = [(name, seed) for name, n in numbers.items() for seed in range(n)]
        rows = [failed_row(name, seed=seed, random=name != "fixed") for name, seed in names]
        return seeds_in_words(standings(rows, [None] * len(rows)))

    assert seeds(a=3, fixed=5) == "3 seeds"
    assert seeds(a=1) == "1 seed"
    assert seeds(a=3, b=1, c=2) == "1 to 3 seeds"
    assert seeds(fixed=3) == ""


def test_suffixes_are_explained_where_they_occur():
    assert suffixes_explained(results(net={}, plane={})) == []
    found = results(**{"net-4-slots-att": {}, "net-2-slots": {}, "other-density": {}})
    assert [note.split(" in a name: ")[0] for note in suffixes_explained(found)] == ["-N-slots", "-att", "-density"]
    assert {*suffixes_explained(found)} <= {*table_notes(found)}


def test_caveats_are_stated_where_they_apply():
    plain = results(net={}, kmeans={"kind": "classical"}, floor={"kind": "floor"})
    assert caveats(plain) == []
    assert [mark for mark, _ in marks_explained(plain)] == []
    special = results(
        net={"views": "1 in, 3 supervise", "tuned": True, "trials": 7},
        plane={"kind": "classical", "priors": ("plane",)},
        foreign={"priors": (), "pretrained": "weights"},
    )
    assert [mark for mark, _ in marks_explained(special)] == ["‡", "§"]
    once = standings([run_row(name, seed=seed, random=False) for name in "ba" for seed in range(2)], [ONES] * 4)
    notes = " ".join([*caveats(special), *caveats(once)])
    assert "Views: how many" in notes
    assert "they find the number of objects: foreign, plane." in notes
    assert "No floor was scored on moving" in notes
    assert "because they do not depend on the seed: a, b." in notes


def test_titles_name_the_track_the_weights_and_the_scenes():
    assert track_title(results(a={})) == "moving"
    assert track_title(results(a={"fit_track": "mixed"})) == "moving, models fitted on mixed"
    given = results(a={"fit_track": "mixed", "pretrained": "weights"})
    assert track_title(given) == "moving, weights trained on mixed"
    assert scenes_title(given) == "3 test scenes; dataset 5bec5bec"
    empty = scene_table({"ari_fg": [np.nan], "msc_fg": [np.nan]})
    assert scenes_title(standings([run_row(n_scenes=1)], [empty])).startswith("1 test scene, 1 without any object;")


TRACKS = {"ycb_video": "moving", "ycb_static": "static"}
MODELS = {
    "obpose_loc_only": "obpose-loc",
    "obpose_loc_rot": "obpose",
    "slot_att": "slot-attention",
    "ic_sbp": "ic-sbp",
}
PUBLISHED = golden()["published_per_seed"]["rows"]

UNSUPPORTED = {
    ("moving", "slot-attention", "miou_bg"): ("0.98±0.02", "0.98±0.00"),
    ("moving", "ic-sbp", "ari_fg"): ("0.87±0.02", "0.86±0.02"),
    ("moving", "ic-sbp", "msc_fg"): ("0.90±0.02", "0.90±0.03"),
    ("static", "slot-attention", "ari_fg"): ("0.80±0.01", "0.79±0.01"),
}
"""Cells of the paper that differ from the scores in its own files: printed, and computed."""


def published() -> list[ModelResult]:
    """Every seed that the authors published, as a run of one scene."""
    pairs = [
        (
            run_row(MODELS[row["model"]], TRACKS[row["track"]], seed, n_scenes=1),
            scene_table({name: [value] for name, value in zip(row["columns"], values, strict=True)}),
        )
        for row in PUBLISHED
        for seed, values in enumerate(row["per_seed"])
    ]
    return standings(*zip(*pairs, strict=True))


@pytest.mark.parametrize(("deviation", "agreeing"), [("std", 20), ("sample_std", 12)])
def test_the_paper_prints_the_population_deviation_without_failed_seeds(deviation: str, agreeing: int):
    cells = {
        (result.row.key.track, result.row.key.model, score.name): (
            paper_scores()[result.row.key.track, result.row.key.model][score.name],
            mean_and_std(summary.mean, getattr(summary, deviation)),
        )
        for result in published()
        for score in SCORES[:3]
        for summary in [result.summary(score.name, without_failed=True)]
    }
    assert len(cells) == 24
    differing = {place: pair for place, pair in cells.items() if pair[0] != pair[1]}
    assert len(differing) == 24 - agreeing
    assert deviation != "std" or differing == UNSUPPORTED


def test_the_seed_that_the_paper_leaves_out_failed_by_our_rule():
    causes = {(result.row.key.track, result.row.key.model): result.causes for result in published()}
    assert causes.pop(("static", "slot-attention")) == ("", "", "swap")
    assert {cause for seeds in causes.values() for cause in seeds} == {""}
    rows = rows_of([result for result in published() if result.place[::2] == ("static", "slot-attention")])
    last = rows["– without the 1 failed of 3 seeds (swap)"]
    assert [score.cell(last) for score in MAIN_SCORES[:3]] == ["0.79±0.01", "0.84±0.00", "1.00±0.00"]


def test_the_file_agrees_with_the_printed_figures():
    for row in PUBLISHED:
        line = paper_of_track(TRACKS[row["track"]])[MODELS[row["model"]]]
        assert [line[name] for name in ("miou_bg", "ari_fg", "msc_fg")] == row["paper"].split()
        assert np.shape(row["per_seed"]) == (3, 3)
    assert list(paper_of_track("static")) == list(paper_of_track("moving"))
    assert paper_of_track("textured") == {}
