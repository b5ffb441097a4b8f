"""Datasets that cannot be scored on are refused before anything runs."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from assets import CHECKPOINTS
from benchmark.commands.arguments import Run
from benchmark.commands.request import job_limits, request_of
from benchmark.execution.executor import Limits
from benchmark.models.registry import GROUPS
from datagen import config
from datagen.errors import UsageError
from datagen.formats.import_request import Request as Import
from datagen.formats.importers.write import import_dataset
from datagen.storage import spec
from obpose.config_text import to_plain
from obpose.systems import find_system
from tests.worlds.imported import import_balls
from tests.worlds.recordings import shoot, write_rgbd
from tests.worlds.traced import spheres_recipe, write_dataset


def request(folder: Path) -> None:
    request_of(Run(model=("plane-dbscan",), data=folder, out=folder.parent / "out"))


def test_a_dataset_of_images_is_accepted(tmp_path: Path):
    request(write_dataset(tmp_path / "data", scenes=1, frames=1))


def test_a_dataset_without_images_is_refused(tmp_path: Path):
    recipe = config.recipe_to_dict(spheres_recipe())
    facts = spec.make_spec(recipe, seed=0, splits={"test": 1}, resolution=None, renderer=None)
    (tmp_path / spec.SPEC_FILE).write_text(json.dumps(facts))
    with pytest.raises(UsageError, match=r"holds no images; make them with: obpose-datagen render --from"):
        request(tmp_path)


def on_real_table(folder: Path, *models: str) -> tuple[str, ...]:
    return request_of(Run(model=models, track=("real-table",), data=folder, out=folder.parent / "out")).models


def test_oracles_are_no_models_for_real_tables(tmp_path: Path):
    """Frames are prepared as by `obpose-segment`, which has no ground truth."""
    folder = import_balls(tmp_path / "with", masks=("test",)).folder
    assert on_real_table(folder, "poses", "training-free") == (
        "plane-hdbscan-boxes", *GROUPS["floors"].members, *GROUPS["classical"].members
    )  # fmt: skip
    for models in (("oracle-k-slots", "training-free"), ("oracles",)):
        with pytest.raises(UsageError, match=r"'oracle-k-slots' needs the ground truth, .* leave it out"):
            on_real_table(folder, *models)


def test_an_equal_budget_goes_with_a_group_unless_another_is_given():
    assert request_of(Run(model=("paper",))).seconds == 720.0
    assert request_of(Run(model=("paper",), budget=30.0)).seconds == 30.0
    assert request_of(Run(model=("obpose",))).seconds is None


def test_the_group_of_tracks_and_the_profile_are_those_of_the_command():
    asked = request_of(Run(model=("plane-dbscan",), track=("paper",), fit_track="mixed", profile="gpu"))
    assert asked.fit_source
    assert [source.name for source in asked.sources] == ["moving", "static", "clevr3d", "multishape"]
    assert {source.resolution for source in (*asked.sources, asked.fit_source)} == {(128, 128), (128, 96)}
    assert asked.profile == "gpu"


def test_slots_are_those_of_objects_and_one_for_the_background():
    assert request_of(Run(model=("obpose",), slots=(3, 6, 3))).slots == (4, 7)


def test_weights_of_a_folder_say_what_they_are_of(tmp_path: Path):
    shipped = Path("obpose--moving--64x64")
    (found,) = request_of(Run(checkpoint=(shipped,))).weights
    assert (found.model, found.name, found.folder) == ("obpose", shipped.name, CHECKPOINTS / shipped)
    both = request_of(Run(model=("plane-dbscan",), checkpoint=(shipped,), name="mine"))
    assert (both.models, [weights.name for weights in both.weights]) == (("plane-dbscan",), ["mine"])
    with pytest.raises(UsageError, match=r"holds no model: there is no config\.json"):
        request_of(Run(checkpoint=(tmp_path,)))
    with pytest.raises(UsageError, match=r"Two of --checkpoint are called 'obpose--moving--64x64'"):
        request_of(Run(checkpoint=(shipped, CHECKPOINTS / shipped)))
    for taken in ("references", "obpose-pretrained", "mine-att"):
        with pytest.raises(UsageError, match=rf"'{taken}' is a name that the benchmark gives itself"):
            request_of(Run(checkpoint=(shipped,), name=taken))
    with pytest.raises(UsageError, match=r"'obpose' is the name of a model; give what is in .* another with --name"):
        request_of(Run(checkpoint=(shipped,), name="obpose"))


@pytest.mark.parametrize("system", ["obpose-none", "slot-attention", "obsurf", "supervised"])
def test_weights_whose_objects_have_no_poses_are_refused_for_editing(tmp_path: Path, system: str):
    found = find_system(system)
    facts = {"version": 1, "architecture": found.architecture.name, "config": to_plain(found.config())}
    (tmp_path / "config.json").write_text(json.dumps(facts))
    assert request_of(Run(checkpoint=(tmp_path,))).weights[0].model == system
    with pytest.raises(UsageError, match=r"no pose that could be edited; give one of obpose, .*, obpose-contact\.$"):
        request_of(Run(task="editing", checkpoint=(tmp_path,)))


@pytest.mark.parametrize(
    ("facts", "reason"),
    [
        ({"name": "mine"}, "--name is for --predictions or one --checkpoint"),
        ({"checkpoint": (Path("nowhere"),)}, "--checkpoint nowhere: no such folder"),
        ({"checkpoint": (Path("obpose--moving--64x64"),), "slots": (4,)}, "--slots is for models that are made here"),
        ({"slots": (0,)}, "--slots is 0; expected 1 to 255"),
        ({"slots": (4, 256)}, "--slots is 256"),
        ({"slots": (4,), "pretrained": True}, "--slots is for models that are made here"),
        ({"steps": 0}, "--steps is 0"),
        ({"steps": 10**100}, "--steps is 1000"),
        ({"seeds": 1001}, "--seeds is 1001; expected 1 to 1000."),
        ({"budget": 0.0}, "--budget is 0; expected 0.001 to 2678400."),
        ({"budget": float("nan")}, "--budget is nan; expected"),
        ({"time_limit": float("-inf")}, "--time-limit is -inf; expected"),
        ({"memory_limit": 1e30}, "expected 1 to 1073741824"),
    ],
)
def test_flags_that_cannot_be_are_refused(facts: dict[str, Any], reason: str):
    with pytest.raises(UsageError, match=reason):
        request_of(Run(model=("obpose",), **facts))


def test_limits_of_jobs_follow_the_flags():
    """--time-limit is in minutes."""
    given = Run(time_limit=5.0, memory_limit=700.0, deterministic=True)
    assert job_limits(given, 999.0) == Limits(300.0, 700.0, 1)
    assert job_limits(Run(), 999.0).seconds == 999.0
    assert job_limits(Run(dask="tcp://127.0.0.1:1"), 999.0) == Limits(999.0, math.inf, 1)


def test_a_dataset_without_test_scenes_is_refused(tmp_path: Path):
    with pytest.raises(UsageError, match="has no test scenes to score on"):
        request(write_dataset(tmp_path / "data", scenes=0))


def test_an_imported_dataset_without_test_scenes_is_to_be_imported_again(tmp_path: Path):
    write_rgbd(tmp_path / "one", [shoot()], masks=True)
    import_dataset(Import(format="rgbd", source=tmp_path / "one", out=tmp_path / "data"))
    with pytest.raises(UsageError, match=r"has no test scenes to score on; import it again, .* --split test"):
        request(tmp_path / "data")


def test_a_dataset_without_masks_is_refused(tmp_path: Path):
    request(import_balls(tmp_path / "with", masks=("test",)).folder)
    with pytest.raises(UsageError, match="has no masks in its test split"):
        request(import_balls(tmp_path / "without", masks=("train",)).folder)
