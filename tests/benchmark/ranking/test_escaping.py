"""Names and messages that would be markup, commands or control sequences if they were printed as they are."""

import csv
import doctest
import importlib
import io
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from benchmark.commands.outputs import means_table
from benchmark.ranking import leaderboard
from benchmark.ranking.escaping import MOST_CHARACTERS, brief, latex, markdown, one_line, printable, terminal
from benchmark.ranking.standings import standings
from benchmark.ranking.tables import latex as latex_page
from benchmark.ranking.tables import markdown as markdown_page
from benchmark.results.run_folder import RunRow, SceneTable
from tests.chosen_scores import failed_row, run_row, save_run, scene_table
from tests.worlds.runs import write_report

HOSTILE = "a|b`c`\n## x <script>alert(1)</script> [x](http://y) [/bold]*z*_~~w~~ & \\ \x1b[31m\u202e \udcff"
IN_FILES = HOSTILE.replace("/", ":").replace("\0", "")


def test_the_examples_in_the_docstrings():
    result = doctest.testmod(importlib.import_module("benchmark.ranking.escaping"))
    assert (result.attempted, result.failed) == (3, 0)


@pytest.mark.parametrize("escaped", [printable, one_line, brief, markdown, latex, lambda text: terminal(text).plain])
def test_a_text_becomes_one_line_that_can_be_stored(escaped):
    text = escaped(HOSTILE)
    assert text.encode()
    assert text.isprintable()
    assert "\n" not in text


def test_long_messages_are_cut_off():
    assert len(brief("word " * 1000)) <= MOST_CHARACTERS
    assert len(brief("x" * 1000)) <= MOST_CHARACTERS
    assert brief("  short\n") == "short"


def test_markdown_shows_a_text_as_it_is():
    escaped = markdown(HOSTILE)
    assert re.sub(r"\\([\\`*_\[\]<>|&~])", r"\1", escaped) == one_line(HOSTILE)
    assert not re.search(r"(?<!\\)[`*_\[\]<>|&~]", escaped.replace("\\\\", ""))


def test_latex_has_no_optional_arguments_after_the_end_of_a_row():
    """A row that begins with [ would be read as the height of the row before."""
    assert latex("[3cm] x") == "{[}3cm{]} x"


def hostile_runs() -> list[tuple[RunRow, SceneTable | None]]:
    scores = scene_table({"ari_fg": np.full(3, 0.5), "msc_fg": np.full(3, 0.5)})
    facts = {
        "track_spec": HOSTILE[:8] * 9,
        "views": HOSTILE,
        "pretrained": HOSTILE,
        "device": HOSTILE,
        "commit": HOSTILE,
    }
    return [
        (run_row(HOSTILE, HOSTILE, kind="classical", priors=(HOSTILE,), **facts), scores),
        (failed_row("net", HOSTILE, reason=HOSTILE, track_spec=facts["track_spec"]), None),
        (run_row("once", HOSTILE, random=False, **facts), scores),
        (run_row("once", HOSTILE, 1, random=False, **facts), scores),
    ]


def test_hostile_names_break_no_table_of_markdown():
    page = markdown_page(standings(*zip(*hostile_runs(), strict=True)))
    rows = [line for line in page.splitlines() if line.startswith("|")]
    assert len({len(re.findall(r"(?<!\\)\|", line)) for line in rows}) == 1
    assert not re.search(r"(?<!\\)<(?!/?sup>)", page)
    assert not re.search(r"(?<!\\)\[", page)
    headings = [line for line in page.splitlines() if line.startswith("#")]
    assert len(headings) == 2
    assert page.isascii() or "\u202e" not in page
    assert page.encode()


def test_hostile_names_break_no_table_of_latex():
    page = latex_page(standings(*zip(*hostile_runs(), strict=True)))
    assert "alert(1)" in page
    assert not re.search(r"\\\\\s*\n\s*\[", page)
    assert all("alert" not in line or line.startswith(("%", "        ", "    ")) for line in page.splitlines())
    assert page.encode()


def test_hostile_names_are_plain_on_the_screen():
    console = Console(width=4000, file=io.StringIO(), force_terminal=True, color_system=None)
    console.print(means_table(standings(*zip(*hostile_runs(), strict=True))))
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    assert "[/bold]" in text
    assert "\x1b[31m" not in text
    assert "\u202e" not in text


class Tags(HTMLParser):
    """Scripts of a page."""

    def __init__(self, text: str):
        super().__init__()
        self.scripts = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.scripts += tag == "script"


def test_hostile_rows_break_neither_tables_nor_page(tmp_path: Path):
    """As they stand in files: what a file name cannot hold does not come from there."""
    scores = scene_table({"ari_fg": np.full(3, 0.5), "msc_fg": np.full(3, 0.5)})
    curve = [{"step": 0.0, "seconds": 0.0, "ari_fg": 0.1}, {"step": 9.0, "seconds": 60.0, "ari_fg": 0.2, "a,b\nc": 1.0}]
    name = IN_FILES.replace("\udcff", "").replace("\n", " ")
    save_run(tmp_path, run_row(name, name, priors=("=1+1", "@x"), learning_curve=curve, device="=cmd()"), scores)
    save_run(tmp_path, failed_row("net", name, reason="=HYPERLINK(1)"), None)
    entries = leaderboard.write(tmp_path)
    with (tmp_path / "leaderboard.csv").open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 2
    assert {line["device"] for line in lines} == {"'=cmd()", "cpu"}
    assert all(not cell.startswith(("=", "+", "@")) for line in lines for cell in line.values())
    write_report(tmp_path, {})
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    plain = Tags(page).scripts
    assert plain == 3
    assert "<script>alert" not in page
    assert entries
