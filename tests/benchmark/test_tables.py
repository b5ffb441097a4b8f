import re

import numpy as np
import pytest

from benchmark.standings import Entry, standings
from benchmark.tables import Board, Line, boards, latex, markdown, mean_and_std
from tests.chosen_scores import failed_row, run_row, scene_table

N = 30
MODELS = {
    "one-cluster": ("floor", 0.1),
    "kmeans": ("classical", 0.4),
    "plane": ("classical", 0.9),
    "obpose": ("learned", 0.8),
    "slot-attention": ("learned", 0.5),
    "truth": ("oracle", 0.99),
}


def entries(track: str = "moving", **changes) -> list[Entry]:
    rng = np.random.default_rng(0)
    rows, tables = [failed_row("obpose", track, seed=1)], [None]
    for name, (kind, score) in MODELS.items():
        values = score + 0.02 * rng.standard_normal(N)
        rows.append(run_row(name, track, n_scenes=N, kind=kind, uses_labels=kind == "oracle", **changes))
        tables.append(scene_table({"ari_fg": values, "msc_fg": values, "ari": values}))
    return standings(rows, tables)


def board(track: str = "moving") -> Board:
    (found,) = boards(entries(track))
    return found


def lines(title: str, track: str = "moving") -> list[Line]:
    return [line for block in board(track).blocks if block.title.startswith(title) for line in block.lines]


def test_blocks_stand_in_order():
    titles = [block.title for block in board().blocks]
    assert titles[:3] == ["Floors", "Without training", "Learned"]
    assert titles[3].startswith("Oracles")
    assert titles[4] == "In the paper, not run here"


def test_the_best_row_without_training_stands_above_the_learned_ones():
    assert [line.label for line in lines("Learned")] == [
        "best without training: plane",
        "slot-attention",
        "obpose",
        "– without the 1 failed of 2 seeds (out of memory)",
    ]


def test_only_ranked_rows_are_ranked_and_bold():
    found = {line.label: line for block in board().blocks for line in block.lines}
    assert [found[name].rank for name in ("plane", "obpose", "slot-attention", "kmeans")] == ["1", "2", "3", "4"]
    assert found["one-cluster"].rank == found["truth †"].rank == ""
    assert found["plane"].bold == (True, True, True, True)
    assert not any(found["truth †"].bold)


def test_the_paper_s_figures_stand_apart():
    found = {line.label: line for block in board().blocks for line in block.lines}
    assert found["obpose"].paper == "1.00±0.00 0.96±0.00 0.97±0.00"
    assert found["plane"].paper == ""
    assert [line.label for line in lines("In the paper")] == [
        "obsurf-no-overlap-depth",
        "obsurf-no-overlap",
        "ic-sbp",
        "obpose-loc",
    ]
    assert all(cell == "" for line in lines("In the paper") for cell in line.cells)
    assert not board("textured").has_paper


def test_where_models_were_fitted_elsewhere_the_title_says_so():
    (found,) = boards(entries(fit_track="mixed")[:-1])[:1]
    assert "models fitted on mixed" in found.title


@pytest.mark.parametrize("track", ["moving", "textured"])
def test_markdown_has_equally_many_cells_in_each_row(track: str):
    text = markdown(entries(track))
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert {line.count("|") for line in tables} == {8 if track == "moving" else 7}
    assert ("other data: not comparable" in text) is (track == "moving")


@pytest.mark.parametrize("track", ["moving", "textured"])
def test_latex_is_well_formed(track: str):
    text = latex(entries(track))
    body = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
    assert body.isascii()
    assert body.count("{") == body.count("}")
    assert body.count(r"\begin") == body.count(r"\end") == 3
    columns = re.search(r"\\begin\{tabular\}\{([lrc ]+)\}", body)
    assert columns
    rows = [line for line in body.splitlines() if line.endswith(r"\\") and "multicolumn" not in line]
    assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {len(columns[1].split()) - 1}
    assert (r"\textcolor{gray}" in body) is (track == "moving")


def test_reasons_of_failures_cannot_break_the_tables():
    reason = "ValueError: 50 % of {x}_1 & y | \\z\nand a second line " + "very " * 40 + "long"
    failed = failed_row("obpose", seed=0, reason=reason)
    found = standings([failed, run_row("obpose", seed=1)], [None, scene_table({"ari_fg": np.ones(3)})])
    rows = [line for line in markdown(found).splitlines() if "failed of 2" in line]
    assert len(rows) == 1
    assert rows[0].count("|") == 8
    assert len(rows[0]) < 200
    assert r"50 \% of \{x\}\_1 \& y | \textbackslash{}z and a second line" in latex(found)


def test_undefined_scores_are_dashes():
    assert mean_and_std(float("nan"), float("nan")) == "–"
    assert mean_and_std(0.976, 0.0009) == "0.98±0.00"
