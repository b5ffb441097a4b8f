"""The documentation: links and anchors lead somewhere, lines are short, tables are whole, named files exist."""

import re
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest

from tests.paths import ROOT

MACHINE_MADE = {"leaderboard.md", "editing.md"}
"""Tables that commands write into run folders; nobody wrote them by hand."""
LONGEST_LINE = 120

FENCE = re.compile(r"^(```|~~~).*?^\1[ \t]*$", re.MULTILINE | re.DOTALL)
CODE = re.compile(r"`[^`\n]+`")
LINK = re.compile(r"\[(?:[^\[\]]|\[[^\]]*\])*\]\(([^()\s]+)\)|(?:src|href)=\"([^\"]+)\"")
HEADING = re.compile(r"^#{1,6} +(.+?) *#*$", re.MULTILINE)
NAMED_FILE = re.compile(r"(?:datagen|obpose|benchmark|assets|docs|tests|examples)/[\w./-]*")
API = re.compile(r"^::: (\S+)$", re.MULTILINE)

PAGES = sorted(
    path
    for path in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / ".github").rglob("*.md"))
    if path.name not in MACHINE_MADE
)


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def prose(text: str) -> str:
    """The text without code."""
    return CODE.sub("", FENCE.sub("", text))


def slug(heading: str) -> str:
    """The anchor of a heading, as GitHub and mkdocs make it."""
    words = LINK.sub(lambda found: found[0].partition("]")[0], heading)
    return re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", words.replace("`", "").lower()).strip())


@cache
def anchors(page: Path) -> list[str]:
    return slugs(page.read_text())


def broken_links(text: str, page: Path) -> Iterator[str]:
    """Links of a page to files or headings that do not exist. Other sites are not visited."""
    for groups in LINK.findall(prose(text)):
        link = next(filter(None, groups))
        if re.match(r"[a-z]+:", link):
            continue
        file, _, anchor = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        if not target.exists():
            yield f"{link}: no such file"
        elif anchor and anchor not in (slugs(text) if target == page else anchors(target)):
            yield f"{link}: no such heading"


def slugs(text: str) -> list[str]:
    return [slug(heading) for heading in HEADING.findall(FENCE.sub("", text))]


def long_lines(text: str) -> list[int]:
    """Numbers of lines that are too long; tables are excepted."""
    lines = enumerate(text.splitlines(), start=1)
    return [number for number, line in lines if len(line) > LONGEST_LINE and not line.startswith("|")]


def ragged_rows(text: str) -> list[str]:
    """Rows of tables that have another number of cells than the row above."""
    lines = FENCE.sub("", text).splitlines()
    pairs = [pair for pair in pairwise(lines) if all(line.startswith("|") for line in pair)]
    return [two for one, two in pairs if cells(one) != cells(two)]


def cells(row: str) -> int:
    return CODE.sub("", row).replace(r"\|", "").count("|")


def missing_files(text: str) -> list[str]:
    """Files of this repository that a text names in code font and that do not exist."""
    named = (code[1:-1] for code in CODE.findall(FENCE.sub("", text)))
    paths = (code.partition("::")[0] for code in named if NAMED_FILE.fullmatch(code.partition("::")[0]))
    return [path for path in paths if not (ROOT / path).exists()]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path):
    assert list(broken_links(page.read_text(), page)) == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_lines_are_short(page: Path):
    assert long_lines(page.read_text()) == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_tables_are_whole(page: Path):
    assert ragged_rows(page.read_text()) == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_named_files_exist(page: Path):
    assert missing_files(page.read_text()) == []


@pytest.mark.parametrize("page", [page for page in PAGES if page.name != "CHANGELOG.md"], ids=name_of)
def test_headings_of_a_page_differ(page: Path):
    """Equal headings get other anchors on GitHub than on the site."""
    assert len({*anchors(page)}) == len(anchors(page))


def test_every_page_is_in_the_navigation_of_the_site():
    listed = set(re.findall(r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    pages = {str(page.relative_to(ROOT / "docs")) for page in PAGES if page.is_relative_to(ROOT / "docs")}
    assert listed == pages


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "api").glob("*.md")), ids=name_of)
def test_the_api_reference_names_modules_that_exist(page: Path):
    for name in API.findall(page.read_text()):
        parts = name.split(".")
        while not (place := ROOT.joinpath(*parts)).with_suffix(".py").exists() and not place.is_dir():
            parts.pop()
        rest = name.split(".")[len(parts) :]
        assert len(rest) <= 1, f"{name}: no such module"
        source = place.with_suffix(".py") if not place.is_dir() else place / "__init__.py"
        assert not rest or re.search(rf"^(class|def) {rest[0]}\b", source.read_text(), re.MULTILINE), name


def test_the_summary_of_the_results_is_short():
    assert len((ROOT / "docs" / "results.md").read_text().splitlines()) <= 250


BAD = """# A page

[gone](gone.md), [other](#elsewhere), ![picture](no.png), <img src="missing.png">
[fine](#a-page) and `[code](nothing.md)`, `datagen/nowhere.py::name`

| a | b |
|---|---|
| `x|y` | fine |
| one cell |
"""


def test_what_is_wrong_is_noticed():
    page = ROOT / "README.md"
    assert len(list(broken_links(BAD, page))) == 4
    assert ragged_rows(BAD) == ["| one cell |"]
    assert missing_files(BAD) == ["datagen/nowhere.py"]
    assert long_lines("x" * 121 + "\n| " + "x" * 121 + " |\n") == [1]
