import pytest

from benchmark.models.interface import Segmenter
from benchmark.models.model_spec import KINDS, PRIORS
from benchmark.models.registry import GROUPS, MODELS, budget_of, discover, expand, find_model
from benchmark.results.run_folder import digest
from datagen.errors import UsageError


def test_an_unknown_name_gets_the_nearest():
    with pytest.raises(UsageError, match="Unknown model 'plane_dbscan'; did you mean 'plane-dbscan'"):
        find_model("plane_dbscan")
    with pytest.raises(UsageError, match="did you mean 'training-free'"):
        expand(["plane-dbscan", "training_free"])


def test_the_group_of_the_paper():
    assert list(GROUPS["paper"].members) == [
        "obpose-loc",
        "obpose",
        "ic-sbp",
        "slot-attention",
        "obsurf",
        "obsurf-no-overlap",
        "obsurf-no-overlap-depth",
    ]
    assert budget_of(["paper"]) == budget_of(["training-free", "paper", "kmeans-xyz-rgb"]) == 12 * 60
    assert budget_of(["training-free", "obpose"]) is None


def test_a_model_named_twice_runs_once():
    names = expand(["plane-dbscan", "classical", "plane-dbscan", "training-free"])
    assert names[0] == "plane-dbscan"
    assert len(names) == len(set(names)) == len(expand(["training-free"]))


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_model_says_what_the_tables_need(name: str):
    spec = MODELS[name]
    assert name not in GROUPS
    assert spec.version >= 1
    assert spec.kind in KINDS
    assert set(spec.priors) <= set(PRIORS)
    assert spec.uses_labels or spec.kind != "oracle"
    assert len(spec.grid) <= 12
    assert len({str(value) for value in spec.grid}) == len(spec.grid)
    assert isinstance(spec.build({"slots": 5, **spec.default}), Segmenter)


def test_every_variant_is_a_model_and_a_constant_of_it_that_changes_makes_new_rows():
    names = ("obpose", "obpose-loc", "obpose-none", "obpose-l2", "obpose-as-published")
    specs = [MODELS[name] for name in names]
    assert {spec.kind for spec in specs} == {"learned"}
    assert {spec.extra for spec in specs} == {("att",)}
    assert {spec.budget for spec in specs} == {23 * 60.0}
    assert len({digest(spec.settings) for spec in specs}) == len(names)


def test_everything_is_discovered():
    models, problems = discover()
    assert set(MODELS) <= set(models)
    assert problems == []
