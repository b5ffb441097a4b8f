import re

import numpy as np
import pytest

from benchmark.ranking.standings import Entry, standings
from benchmark.ranking.table_text import mean_and_std
from benchmark.ranking.tables import Board, Line, boards, latex, markdown
from benchmark.results.run_folder import RunRow
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


def test_the_block_with_the_best_model_stands_on_top():
    titles = [block.title for block in board().blocks]
    assert titles[:3] == ["Without training", "Learned", "Floors"]
    assert titles[3].startswith("Oracles")
    assert titles[4] == "In the paper, not run here"
    scores = {"plane": ("classical", 0.5), "obpose": ("learned", 0.9), "mine": ("predictions", 0.4)}
    rows = [run_row(name, kind=kind) for name, (kind, _) in scores.items()]
    tables = [scene_table({"ari_fg": [score] * 3, "msc_fg": [score] * 3}) for _, score in scores.values()]
    (other,) = boards(standings(rows, tables))
    assert [block.title for block in other.blocks][:3] == ["Learned", "Without training", "Given label maps"]
    assert [line.label for line in other.blocks[0].lines] == ["obpose", "best without training: plane"]


@pytest.mark.parametrize("track", ["moving", "textured"])
def test_the_best_rank_comes_first_in_every_block_and_in_the_table(track: str):
    ranks = [[float(line.rank) for line in block.lines if line.rank] for block in board(track).blocks]
    assert all(places == sorted(places) for places in ranks)
    assert next(filter(None, ranks))[0] == 1


def test_the_best_row_without_training_stands_among_the_learned_ones_by_rank():
    assert [line.label for line in lines("Learned")] == [
        "best without training: plane",
        "obpose",
        "– without the 1 failed of 2 seeds (out of memory)",
        "slot-attention",
    ]


def seen(**rows: dict[str, object]) -> list[Entry]:
    scores = scene_table({"ari_fg": np.ones(3), "msc_fg": np.ones(3)})
    return standings([run_row(name, **facts) for name, facts in rows.items()], [scores] * len(rows))


def test_a_row_says_how_many_views_its_model_uses_where_one_does():
    found = seen(
        obpose={"views": "3 in, 3 supervise"}, obsurf={"views": "1 in, 3 supervise"}, plane={"kind": "classical"}
    )
    text = markdown(found)
    assert "| model | views | rank |" in text
    assert "| --- | --- | ---: |" in text
    assert "| obsurf | 1 in, 3 supervise | 2 | 1 |" in text
    assert "| plane |  | 2 | 1 |" in text
    assert r"\textsc{obpose} & 3 in, 3 supervise & 2 & 1 & " in latex(found)
    assert r"\begin{tabular}{l l r r c" in latex(found)
    assert "- Views: how many" in text
    assert "iews" not in markdown(seen(obpose={}, obsurf={})) + latex(seen(obpose={}))


def test_a_model_that_learned_from_labels_stands_with_the_oracles_and_has_no_rank():
    (found,) = boards(seen(plane={"kind": "classical"}, supervised={"uses_labels": True}))
    assert [block.title.partition(" ")[0] for block in found.blocks] == ["Without", "Oracles", "In"]
    (line,) = found.blocks[1].lines
    assert (line.label, line.rank) == ("supervised †", "")


def test_only_ranked_rows_are_ranked_and_bold():
    found = {line.label: line for block in board().blocks for line in block.lines}
    assert [found[name].rank for name in ("plane", "obpose", "slot-attention", "kmeans")] == ["1", "2", "3", "4"]
    assert found["one-cluster"].rank == found["truth †"].rank == ""
    assert found["plane"].bold == (True, True, True, True, False, False)
    assert not any(found["truth †"].bold)


def test_every_row_says_how_many_seeds_its_mean_covers():
    found = {line.label: line.seeds for block in board().blocks for line in block.lines}
    assert (found["plane"], found["obpose"]) == ("1", "1 of 2")
    assert found["– without the 1 failed of 2 seeds (out of memory)"] == "1 of 2"
    swapped = scene_table({"msc_fg": [0.9] * 3, "miou_bg": [0.1] * 3})
    rows = [run_row(), run_row(seed=1)]
    (kept,) = boards(standings(rows, [scene_table({"msc_fg": [0.5] * 3}), swapped]))
    assert [line.seeds for line in kept.blocks[0].lines] == ["2", "1 of 2"]
    fixed = [run_row("fixed", seed=seed, random=False) for seed in range(3)]
    (once,) = boards(standings(fixed, [scene_table({"msc_fg": [0.5] * 3})] * 3))
    assert [line.seeds for line in once.blocks[0].lines] == ["1"]


def test_a_model_whose_every_seed_failed_is_neither_ranked_nor_bold():
    scores = {"ari_fg": [0.9] * 3, "msc_fg": [0.9] * 3}
    rows, tables = [run_row("swapped"), run_row("fine")], [scene_table(scores | {"miou_bg": [0.1] * 3})]
    (found,) = boards(standings(rows, [*tables, scene_table({name: [0.5] * 3 for name in scores})]))
    lines = {line.label: line for line in found.blocks[0].lines}
    assert (lines["swapped"].rank, any(lines["swapped"].bold)) == ("", False)
    assert (lines["fine"].rank, lines["fine"].bold[1:3]) == ("1", (True, True))


def test_equal_models_share_a_rank():
    scores = scene_table({"ari_fg": [0.5] * 3, "msc_fg": [0.5] * 3})
    (found,) = boards(standings([run_row("a"), run_row("b")], [scores] * 2))
    assert [line.rank for line in found.blocks[0].lines] == ["1.5", "1.5"]


def test_columns_that_use_the_truth_are_marked():
    header = next(line for line in markdown(entries()).splitlines() if line.startswith("| model"))
    assert "| mIoU-BG | ARI-FG | MSC-FG | ARI | mIoU-BG† | MSC-FG† |" in header
    assert r"mIoU-BG$\dagger$$\uparrow$ & MSC-FG$\dagger$$\uparrow$" in latex(entries())
    assert "† in a heading" in markdown(entries())


def test_notes_say_where_a_collapse_cannot_be_seen():
    assert "No floor" not in markdown(entries())
    alone = standings([run_row("net")], [scene_table({"ari_fg": np.ones(3)})])
    assert "No floor was scored on moving" in markdown(alone)
    assert "No floor was scored on moving" in latex(alone)


def test_notes_name_the_models_that_are_not_held_to_the_slots():
    rows = [run_row("plane", kind="classical", priors=("plane",)), run_row("kmeans", kind="classical")]
    rows += [run_row("foreign", priors=())]
    text = markdown(standings(rows, [scene_table({"ari_fg": np.ones(3)})] * 3))
    assert "- Not held to the track's number of slots: plane;" in text
    assert "Not held" not in markdown(entries())


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


def test_weights_that_were_given_were_trained_elsewhere():
    rows = [run_row("a", fit_track="mixed", pretrained="weights")]
    (found,) = boards(standings(rows, [scene_table({"ari_fg": [0.5] * 3})]))
    assert "moving, weights trained on mixed" in found.title


@pytest.mark.parametrize("track", ["moving", "textured"])
def test_markdown_has_equally_many_cells_in_each_row(track: str):
    text = markdown(entries(track))
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert {line.count("|") for line in tables} == {11 if track == "moving" else 10}
    assert ("other data: not comparable" in text) is (track == "moving")


@pytest.mark.parametrize("track", ["moving", "textured"])
def test_latex_is_well_formed(track: str):
    body = latex_body(latex(entries(track)))
    assert nested_environments(body) == ["table*", "adjustbox", "tabular"]
    assert len(set(widths(body))) == 1
    assert (r"\textcolor{gray}" in body) is (track == "moving")


def test_names_cannot_break_latex():
    name = "50%_of_a&b#c${d}~e^f\\g"
    rows = [run_row(name, name, kind=kind, fit_track="x_%") for kind in ("floor", "learned", "predictions")]
    body = latex_body(latex(standings(rows, [scene_table({"ari_fg": np.ones(3)})] * len(rows))))
    assert nested_environments(body) == ["table*", "adjustbox", "tabular"]
    assert len(set(widths(body))) == 1
    assert r"50\%\_of\_a\&b\#c\$\{d\}\~{}e\^{}f\textbackslash{}g" in body
    assert r"models fitted on x\_\%" in body


def test_the_checks_of_latex_see_what_is_wrong():
    body = latex_body(latex(entries()))
    for wrong in (
        body.replace(r"\end{adjustbox}", ""),
        body.replace(r"\end{tabular}", r"\end{table}"),
        body.replace("kmeans", "k_means"),
        body.replace("kmeans", "k{means"),
        body.replace("kmeans", "k%means"),
        body.replace("kmeans", "k$means"),
        body.replace("kmeans", "k&means"),
        body.replace("l r r c", "l r r"),
        body.replace("multicolumn{10}", "multicolumn{9}"),
    ):
        with pytest.raises(AssertionError):
            assert wrong == body or (nested_environments(wrong) and len(set(widths(wrong))) == 1)


def latex_body(text: str) -> str:
    """Without the lines of notes."""
    return "\n".join(line for line in text.splitlines() if not line.startswith("%"))


def nested_environments(body: str) -> list[str]:
    """Names of the environments, after a check that they, braces and dollars match, and nothing is left unescaped."""
    assert body.isascii()
    bare = re.sub(r"\\[\\%_&#${}~^]", "", body)
    assert bare.count("{") == bare.count("}")
    assert all(line.count("$") % 2 == 0 for line in bare.splitlines())
    assert not re.search(r"[%#~]", bare)
    assert not re.search(r"[_^]", re.sub(r"\$[^$]*\$", "", bare))
    names, still_open = [], []
    for command, name in re.findall(r"\\(begin|end)\{([^}]*)\}", body):
        if command == "begin":
            names.append(name)
            still_open.append(name)
        else:
            assert still_open.pop() == name
    assert still_open == []
    return names


def widths(body: str) -> list[int]:
    """Columns of the table as declared, and of each of its rows."""
    declared = re.search(r"\\begin\{tabular\}\{([lrc ]+)\}", body)
    assert declared
    found = [len(declared[1].split())]
    for row in (line for line in body.splitlines() if line.endswith(r"\\")):
        spans = [int(span) for span in re.findall(r"\\multicolumn\{(\d+)\}", row)]
        found.append(len(re.findall(r"(?<!\\)&", row)) + 1 + sum(spans) - len(spans))
    return found


def test_reasons_of_failures_cannot_break_the_tables():
    reason = "ValueError: 50 % of {x}_1 & y | \\z\nand a second line " + "very " * 40 + "long"
    failed = failed_row("obpose", seed=0, reason=reason)
    found = standings([failed, run_row("obpose", seed=1)], [None, scene_table({"ari_fg": np.ones(3)})])
    rows = [line for line in markdown(found).splitlines() if "failed of 2" in line]
    assert len(rows) == 1
    assert len(re.findall(r"(?<!\\)\|", rows[0])) == 11
    assert len(rows[0]) < 240
    assert r"50 \% of \{x\}\_1 \& y \textbar{} \textbackslash{}z and a second line" in latex(found)


def test_notes_say_how_many_seeds_there_are():
    def note(*rows: RunRow) -> str:
        found = standings(rows, [scene_table({"ari_fg": np.ones(3)})] * len(rows))
        return next(line for line in markdown(found).splitlines() if "under-cover" in line)

    assert "here models have 2 seeds" in note(*(run_row("net", seed=seed) for seed in range(2)))
    assert "here models have 1 seed." in note(run_row("net"))
    assert "1 to 4 seeds" in note(*(run_row("net", seed=seed) for seed in range(4)), run_row("shipped"))
    fixed = [run_row("fixed", seed=seed, random=False) for seed in range(3)]
    assert "1 seed." in note(*fixed, run_row("net"))
    assert "three" not in note(run_row("net"))


def test_notes_name_the_models_that_were_run_once():
    rows = [run_row(name, seed=seed, random=name == "net") for name in ("b", "a", "net") for seed in range(2)]
    text = markdown(standings(rows, [scene_table({"ari_fg": np.ones(3)})] * len(rows)))
    assert "- Run once, as seeds make no difference to them: a, b.\n" in text
    assert "Run once" not in markdown(entries())


def test_a_failure_that_stands_for_all_seeds_counts_once():
    rows = [failed_row("fixed", seed=seed, random=False) for seed in range(3)]
    assert "without the 1 failed of 1 seed (out of memory)" in markdown(standings(rows, [None] * 3))


def test_titles_count_scenes():
    assert "1 scene," in board_of(1).title
    assert "2 scenes," in board_of(2).title


def board_of(scenes: int) -> Board:
    scores = scene_table({name: [np.nan] * scenes for name in ("ari_fg", "msc_fg")})
    (found,) = boards(standings([run_row(n_scenes=scenes)], [scores]))
    return found


def test_no_figure_is_minus_zero():
    assert mean_and_std(-0.001, 0.0) == "0.00±0.00"
    assert mean_and_std(-0.01, 0.0) == "-0.01±0.00"
    table = scene_table({"ari_fg": [-0.001], "msc_fg": [-0.001]})
    (found,) = boards(standings([run_row(n_scenes=1)], [table]))
    (line,) = found.blocks[0].lines
    assert line.cells[1] == "0.00"
    assert line.bold[1]


def test_undefined_scores_are_dashes():
    assert mean_and_std(float("nan"), float("nan")) == "–"
    assert mean_and_std(0.976, 0.0009) == "0.98±0.00"


def test_a_single_seed_has_no_deviation():
    scores = [scene_table({"ari_fg": [score] * 3, "msc_fg": [score] * 3}) for score in (0.5, 0.7, 0.9)]
    rows = [run_row("one"), run_row("two"), run_row("two", seed=1)]
    rows += [run_row("fixed", seed=seed, random=False) for seed in range(3)]
    rows += [run_row("half"), failed_row("half", seed=1)]
    found = standings(rows, [scores[0], scores[1], scores[2], *[scores[0]] * 4, None])
    cells = {line.label: line.cells[1] for block in boards(found)[0].blocks for line in block.lines}
    assert (cells["one"], cells["fixed"], cells["half"]) == ("0.50", "0.50", "0.50")
    assert cells["two"] == "0.80±0.10"
    assert r"$0.50^{" in latex(found)
    assert "±0" not in markdown(standings([run_row("one", "textured")], scores[:1]))
