"""Packages are written to disk as an installer leaves them, and found the way that installed ones are."""

import dataclasses
import sys
from pathlib import Path

import pytest

from benchmark.models.model_spec import ModelSpec, Views
from benchmark.models.plugins import Problem
from benchmark.models.registry import discover, expand, find_model
from datagen.errors import UsageError
from tests.worlds.sphere_clips import arbitrary

SMALLEST = '''
import numpy as np
from benchmark.models.interface import Prediction

class Nothing:
    """Sees nothing.

    And says so."""

    def fit(self, train, val, *, seed, budget):
        pass

    def segment(self, clip):
        return Prediction(np.zeros(clip.depth.shape, int), background_slot=0)
'''


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Installs a package of one module."""
    monkeypatch.syspath_prepend(tmp_path)

    def write(package: str, source: str, **entries: str) -> None:
        monkeypatch.delitem(sys.modules, package, raising=False)
        (tmp_path / f"{package}.py").write_text(source)
        facts = tmp_path / f"{package}-1.0.dist-info"
        facts.mkdir()
        (facts / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
        lines = [f"{name.replace('_', '-')} = {value}" for name, value in entries.items()]
        (facts / "entry_points.txt").write_text("[obpose.models]\n" + "\n".join(lines) + "\n")

    return write


def only_problem() -> Problem:
    _, problems = discover()
    assert len(problems) == 1
    return problems[0]


def test_plugins_are_not_imported_for_our_own_models(install):
    install("nothingnet", SMALLEST, nothing="nothingnet:Nothing")
    assert find_model("plane-dbscan")
    assert expand(["training-free"])
    assert "nothingnet" not in sys.modules


def test_a_class_with_fit_and_segment_is_a_model(install):
    install("nothingnet", SMALLEST, nothing="nothingnet:Nothing")
    spec = find_model("nothing")
    assert (spec.version, spec.description, spec.kind, spec.grid) == (1, "Sees nothing.", "learned", ())
    assert not spec.uses_labels
    model = spec.build({"slots": 5, "steps": 10})
    model.fit([], [], seed=0, budget=1.0)
    assert not model.segment(arbitrary(0)).labels.any()
    assert expand(["nothing", "one-cluster"]) == ["nothing", "one-cluster"]
    assert "nothing" not in expand(["training-free"])


def test_attributes_say_more(install):
    said = """
    version, description, kind, random, uses_labels = 3, "Sees much.", "classical", False, True
    priors = ("slots", "plane")
    options = ({"depth": 2}, {"depth": 3})
    budget, extra = 60.0, ("fine", "coarse")
    views = ("one", "all")

    def __init__(self, slots, depth=1, folder=None, changes=None):
        self.slots, self.depth, self.folder = slots, depth, folder
"""
    install("muchnet", SMALLEST + said, much="muchnet:Nothing")
    spec = find_model("much")
    expected = ModelSpec(
        spec.build, 3, "Sees much.", "classical", ({"depth": 2}, {"depth": 3}), False, True, ("slots", "plane")
    )
    expected = dataclasses.replace(expected, budget=60.0, extra=("fine", "coarse"))
    expected = dataclasses.replace(expected, views=Views("one", "all"))
    assert spec == expected
    model = spec.build({"slots": 5, "steps": 10, "folder": Path("f"), **spec.grid[1]})
    assert vars(model) == {"slots": 5, "depth": 3, "folder": Path("f")}


@pytest.mark.parametrize(
    ("addition", "entry", "reason"),
    [
        ("1 / 0", "Nothing", "does not import: ZeroDivisionError: division by zero"),
        ("", "Missing", "does not import: AttributeError"),
        ("class Half:\n    def fit(self): ...", "Half", "has no method 'segment'"),
        ("Nothing.version = 'two'", "Nothing", "version is 'two'; expected int"),
        ("Nothing.version = 0", "Nothing", "version is 0; the first is 1"),
        ("net = Nothing()", "net", "has no method 'fit'; a model is a class"),
        ("Nothing.kind = 'magic'", "Nothing", "kind is 'magic'; expected one of floor"),
        ("Nothing.priors = ('luck',)", "Nothing", "priors name 'luck'; expected some of slots"),
        ("Nothing.options = ({'depth': 2},)", "Nothing", "does not take the options {'depth': 2}"),
        ("Nothing.options = (2,)", "Nothing", "options hold 2; expected a dict"),
        ("Nothing.budget = -1.0", "Nothing", "budget is -1; expected more than 0"),
        ("Nothing.extra = 'fine'", "Nothing", "extra is 'fine'; expected tuple"),
        ("Nothing.extra = (1,)", "Nothing", "extra holds 1; expected names"),
        ("Nothing.extra = ('../../evil',)", "Nothing", "'broken-../../evil' cannot be a model's name"),
        ("Nothing.kind = 'predictions'", "Nothing", "expected one of floor, classical, oracle, learned."),
        ("Nothing.budget = float('nan')", "Nothing", "budget is nan; expected more than 0"),
        ("raise SystemExit(3)", "Nothing", "does not import: SystemExit: 3"),
        (
            "class Meta(type):\n    @property\n    def version(cls): raise ValueError('no')\n"
            "class Odd(Nothing, metaclass=Meta): ...",
            "Odd",
            "it cannot be read: ValueError: no",
        ),
        ("Nothing.views = ('one', 'two')", "Nothing", "expected two of one, all"),
        ("class Greedy(Nothing):\n    def __init__(self, layers): ...", "Greedy", "does not take the options {}"),
    ],
)
def test_a_broken_plugin_is_named_and_breaks_no_other(install, addition: str, entry: str, reason: str):
    install("brokennet", f"{SMALLEST}\n{addition}\n", broken=f"brokennet:{entry}")
    problem = only_problem()
    assert problem.name == "broken"
    assert "package brokennet" in problem.reason
    assert reason in problem.reason
    assert "plane-dbscan" in discover()[0]
    with pytest.raises(UsageError, match="Model 'broken' cannot be used: package brokennet"):
        find_model("broken")


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("../../evil", "'../../evil' cannot be a model's name"),
        ("a--b", "two dashes in a row"),
        ("Plane-DBSCAN", "'plane-dbscan' is one of obpose's own"),
        ("net-pretrained", "gives itself"),
    ],
)
def test_a_name_that_cannot_be_part_of_a_path_is_refused(install, tmp_path: Path, name: str, reason: str):
    install("pathnet", SMALLEST, good="pathnet:Nothing")
    facts = tmp_path / "pathnet-1.0.dist-info" / "entry_points.txt"
    facts.write_text(f"[obpose.models]\ngood = pathnet:Nothing\n{name} = pathnet:Nothing\n")
    problem = only_problem()
    assert reason in problem.reason
    assert problem.reason.isprintable()
    assert "good" in discover()[0]
    assert name not in discover()[0]
    with pytest.raises(UsageError, match="cannot be used"):
        find_model(name)


def test_names_that_differ_in_case_only_are_nobodys(install):
    install("one", SMALLEST, net="one:Nothing")
    install("two", SMALLEST, Net="two:Nothing")
    assert not {"net", "Net"} & set(discover()[0])
    with pytest.raises(UsageError, match="2 entry points have the name 'Net', upper and lower case being equal"):
        find_model("Net")


def test_a_further_segmentation_has_a_name_of_its_own(install):
    install("one", SMALLEST + "    extra = ('fine',)\n", net="one:Nothing")
    install("two", SMALLEST, net_fine="two:Nothing")
    assert "net-fine is a model; give it another name" in only_problem().reason
    assert "net-fine" in discover()[0]


def test_reasons_are_one_line(install):
    install("loud", SMALLEST + "\nraise ValueError('a\\nb\\x1b[31m' + 'x' * 5000)\n", loud="loud:Nothing")
    assert only_problem().reason.isprintable()
    assert len(only_problem().reason) <= 300
