import unicodedata

import pytest

from benchmark.names import base_name, check_model_name, check_row_name, find_twin, suffixes_of
from datagen.errors import UsageError
from datagen.storage.portable_names import check_dataset_name

GOOD = ("obpose", "plane-dbscan-colour", "my model 2", "v1.0+cuda_12", "Größe", "obpose--moving--64x64", "a" * 80)
BAD = (
    "",
    " ",
    ".",
    "..",
    "../..",
    "../evil",
    "/etc/passwd",
    "a/b",
    "a\\b",
    "a\0b",
    ".hidden",
    "-rf",
    "_x",
    "a ",
    " a",
    "a  b",
    "a\nb",
    "a\n",
    "a\tb",
    "a|b",
    "a`b`",
    "<script>",
    "[x](y)",
    "a.",
    "a" * 81,
    "ß" * 41,
    "a:b",
    "a*",
    "a?",
    "\u202eabc",
    "a\u200bb",
    "a\udcff",
    "~root",
    "$HOME",
    "=1+1",
    unicodedata.normalize("NFD", "Größe"),
)
RESERVED = (
    "references",
    "obpose-pretrained",
    "mine-att",
    "mine-density",
    "mine-refined",
    "mine-3-slots",
    "Mine-PRETRAINED",
    "References",
)


@pytest.mark.parametrize("name", GOOD)
def test_a_name_that_is_safe_in_file_names_is_accepted(name: str):
    check_model_name(name, "")
    check_dataset_name(name)


@pytest.mark.parametrize("name", BAD)
def test_a_name_that_is_not_is_refused_in_one_printable_line(name: str):
    for check in (lambda: check_model_name(name, "Give one with --name."), lambda: check_dataset_name(name)):
        with pytest.raises(UsageError, match="expected at most 80 bytes of letters") as error:
            check()
        assert str(error.value).isprintable()
        assert len(str(error.value)) < 400


@pytest.mark.parametrize("name", RESERVED)
def test_names_that_the_benchmark_makes_are_for_it_alone(name: str):
    with pytest.raises(UsageError, match="is a name that the benchmark gives itself"):
        check_model_name(name, "")
    check_row_name(name, "")


def test_upper_and_lower_case_make_no_other_name():
    assert find_twin("Plane-DBSCAN", ["one", "plane-dbscan"]) == "plane-dbscan"
    assert find_twin("STRASSE", ["straße"]) == "straße"
    assert find_twin("plane", ["plane-dbscan"]) is None


@pytest.mark.parametrize(
    ("name", "base", "suffixes"),
    [
        ("obpose", "obpose", []),
        ("plane-dbscan-tracked", "plane-dbscan-tracked", []),
        ("attention", "attention", []),
        ("obpose-contact-pretrained-density", "obpose-contact", ["-pretrained", "-density"]),
        ("obpose-12-slots-att", "obpose", ["-N-slots", "-att"]),
        ("mine-refined", "mine", ["-refined"]),
    ],
)
def test_suffixes_are_told_from_the_names_of_models(name: str, base: str, suffixes: list[str]):
    assert (base_name(name), suffixes_of(name)) == (base, suffixes)
