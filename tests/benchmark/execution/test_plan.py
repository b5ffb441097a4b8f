import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest

from assets import CHECKPOINTS
from benchmark.commands.arguments import Run
from benchmark.commands.request import request_of
from benchmark.execution.jobs import OVERHEAD, STARTING_SECONDS, Job, Target, blank_row
from benchmark.execution.plan import (
    SCENE_SECONDS,
    SCORING_SECONDS,
    Plan,
    Request,
    Weights,
    check_places,
    estimate,
    make_plan,
    superseded,
)
from benchmark.models import registry
from benchmark.models.model_spec import ModelSpec
from benchmark.results.run_folder import RunKey, RunRow, load_runs
from datagen.errors import UsageError
from datagen.tracks import SIZES, Track, find_track
from tests.paths import ROOT

MOVING, MIXED, TOUCHING, CLEVR = (find_track(name) for name in ("moving", "mixed", "touching", "clevr3d"))
OUT = Path("out")


@pytest.fixture
def register(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    def never(options: object) -> None:
        raise AssertionError

    def add(**facts: object) -> None:
        monkeypatch.setitem(registry.MODELS, "net", ModelSpec(never, 1, "", **facts))  # type: ignore[arg-type]

    add()
    return add


def plan(*models: str, rows: tuple[RunRow, ...] = (), tracks: tuple[Track, ...] = (MOVING,), **facts: object) -> Plan:
    return make_plan(Request(models or ("net",), tracks, **facts), rows, OUT)  # type: ignore[arg-type]


def done(made: Plan) -> tuple[RunRow, ...]:
    return tuple(blank_row(key, registry.MODELS["net"], status="ok") for key in made.keys)


def test_rows_that_were_made_before_there_were_models_that_learn_are_still_wanted():
    rows = load_runs(ROOT / "docs" / "results")
    rows = [row for row in rows if row.kind in ("floor", "classical", "oracle")]
    tracks = tuple(map(find_track, {row.key.track for row in rows}))
    models = tuple(dict.fromkeys(row.key.model for row in rows))
    fits = (None, *map(find_track, {row.key.fit_track for row in rows}))
    wanted = {key for fit in fits for key in make_plan(Request(models, tracks, fit_source=fit), rows, OUT).keys}
    assert rows
    assert {row.key for row in rows} <= wanted


def test_a_model_s_own_budget_holds_unless_the_command_says_otherwise(register):
    register(budget=77.0)
    assert {job.seconds for job in plan().jobs} == {77.0}
    assert {job.seconds for job in plan(seconds=5.0).jobs} == {5.0}


def test_rows_of_other_budgets_never_mix(register):
    keys = {plan(**facts).keys[0].config_hash for facts in ({}, {"seconds": 5.0}, {"steps": 5}, {"steps": 6})}
    assert len(keys) == 4
    register(budget=5.0)
    assert plan().keys == plan(seconds=5.0).keys


def given(*seeds: int, digest: str, model: str = "mine") -> list[RunRow]:
    """Rows of label maps made elsewhere."""
    keys = [RunKey("moving", "moving", model, seed, 1, digest, "d", "d") for seed in seeds]
    return [blank_row(key, None, status="ok") for key in keys]


def test_label_maps_that_are_replaced_leave_no_seed_behind():
    """A seed of other maps, or of another background slot, would stand among the new ones as if it were one of them."""
    there = given(0, 1, 2, digest="old") + given(0, digest="old", model="yours")
    assert superseded([row.key for row in given(0, 1, digest="new")], there) == there[:3]
    assert superseded([row.key for row in given(0, 1, digest="old")], there) == []
    assert superseded([row.key for row in given(0, 1, 2, 3, digest="old")], there) == []


def test_seeds_of_a_model_that_were_not_asked_for_stay(register):
    rows = done(plan(seeds=3, steps=5))
    assert superseded(plan(seeds=2, steps=6).keys, rows) == list(rows[:2])


def test_other_label_maps_of_the_same_name_are_refused():
    with pytest.raises(UsageError, match=r"mine on moving .* label maps or --background-slot.*--name"):
        check_places([given(0, digest="new")[0].key], given(0, digest="old"))


def test_a_row_of_another_version_of_the_dataset_is_named_as_such(register):
    key = plan().keys[0]
    other = blank_row(dataclasses.replace(key, track_spec="other"), registry.MODELS["net"], status="ok")
    with pytest.raises(UsageError, match=r"net on moving of another version of the dataset \(different: track_spec\)"):
        check_places([key], [other])


def test_constants_of_a_model_are_part_of_the_key(register):
    register(settings={"width": 1})
    narrow = plan().keys
    register(settings={"width": 2})
    assert not set(narrow) & set(plan().keys)


def test_changes_on_a_track_are_part_of_the_key_there_and_nowhere_else(register):
    before = {key.track: key.config_hash for key in plan(tracks=(MOVING, CLEVR)).keys}
    register(on_tracks={"clevr3d": {"size": 2}})
    after = {key.track: key.config_hash for key in plan(tracks=(MOVING, CLEVR)).keys}
    assert after["moving"] == before["moving"]
    assert after["clevr3d"] != before["clevr3d"]


def test_changes_at_test_are_part_of_the_key_on_that_track_and_share_the_training(register):
    usual = {key.track: key.config_hash for key in plan(tracks=(MOVING, TOUCHING), fit_source=MIXED, seeds=1).keys}
    register(at_test={"moving": {"bias": 2}})
    changed = plan(tracks=(MOVING, TOUCHING), fit_source=MIXED, seeds=1)
    hashes = {key.track: key.config_hash for key in changed.keys}
    assert hashes["touching"] == usual["touching"]
    assert hashes["moving"] != usual["moving"]
    assert len(changed.jobs) == 1


def test_further_segmentations_are_rows_of_the_same_work(register):
    register(extra=("att",))
    made = plan(seeds=2)
    assert [(key.model, key.seed) for key in made.keys] == [("net", 0), ("net", 1), ("net-att", 0), ("net-att", 1)]
    assert [len(job.targets) for job in made.jobs] == [1, 1]
    assert plan(seeds=2, rows=done(made)).jobs == ()
    lost = [row for row in done(made) if (row.key.model, row.key.seed) != ("net-att", 1)]
    assert [job.seed for job in plan(seeds=2, rows=tuple(lost)).jobs] == [1]


def test_a_model_that_learns_finds_its_folder_again_whatever_is_scored(register):
    both = plan(tracks=(MOVING, TOUCHING), fit_source=MIXED, seeds=1).jobs
    one = plan(tracks=(TOUCHING,), fit_source=MIXED, seeds=1).jobs
    assert len(both) == len(one) == 1
    assert both[0].folder == one[0].folder
    folders = [job.folder for facts in ({}, {"steps": 3}, {"fit_source": MIXED}) for job in plan(**facts).jobs]
    assert len(set(folders)) == len(folders) == 9
    register(kind="classical")
    assert {job.folder for job in plan().jobs} == {None}


def names(made: Plan) -> list[str]:
    return list(dict.fromkeys(key.model for key in made.keys))


def test_numbers_of_slots_are_models_of_their_own_and_the_track_s_own_is_the_plain_one(register):
    register(extra=("att",))
    made = plan(slots=(4, 5, 7), seeds=1)
    assert names(made) == ["net", "net-3-slots", "net-3-slots-att", "net-6-slots", "net-6-slots-att", "net-att"]
    assert {(job.targets[0].key.model, job.fit_slots, job.targets[0].slots) for job in made.jobs} == {
        ("net", 5, 5),
        ("net-3-slots", 4, 4),
        ("net-6-slots", 7, 7),
    }
    assert set(plan(seeds=1).keys) < set(made.keys)
    assert len({job.folder for job in made.jobs}) == 3


def test_which_number_is_the_plain_one_is_the_track_s_affair(register):
    made = plan(slots=(5, 7), tracks=(MOVING, CLEVR), seeds=1)
    assert [(key.track, key.model) for key in made.keys] == [
        ("clevr3d", "net"),
        ("clevr3d", "net-4-slots"),
        ("moving", "net"),
        ("moving", "net-6-slots"),
    ]


def test_a_model_that_learns_has_the_slots_of_its_training(register):
    assert names(plan(slots=(5,), tracks=(CLEVR,), fit_source=MIXED)) == ["net"]
    assert names(plan(slots=(7,), tracks=(CLEVR,), fit_source=MIXED)) == ["net-6-slots"]
    register(kind="classical")
    assert names(plan(slots=(5,), tracks=(CLEVR,), fit_source=MIXED)) == ["net-4-slots"]
    assert names(plan(slots=(5,), tracks=(MOVING,), fit_source=MIXED)) == ["net"]


def test_models_that_find_the_number_of_objects_themselves_run_once():
    made = plan("plane-dbscan", "kmeans-xyz-rgb", slots=(3, 9), seeds=1)
    assert names(made) == ["kmeans-xyz-rgb-2-slots", "kmeans-xyz-rgb-8-slots", "plane-dbscan"]
    assert plan("plane-dbscan", seeds=1).keys[0] in made.keys


def test_the_profile_is_part_of_what_a_model_that_learns_is(register):
    register(settings={"width": 1}, profiles={"gpu": {"width": 2}})
    (small, *_), (large, *_) = plan().jobs, plan(profile="gpu").jobs
    assert (small.profile, large.profile) == ("cpu", "gpu")
    assert small.folder != large.folder
    register()
    assert plan().keys != plan(profile="gpu").keys
    register(kind="classical")
    assert plan().keys == plan(profile="gpu").keys


def test_shipped_weights_take_one_seed_and_the_test_split():
    made = plan("obpose", fit_source=MIXED, pretrained=True)
    assert [(key.model, key.fit_track, key.seed) for key in made.keys] == [
        ("obpose-pretrained", "mixed", 0),
        ("obpose-pretrained-att", "mixed", 0),
    ]
    assert [(job.model, job.checkpoint) for job in made.jobs] == [("obpose", CHECKPOINTS / "obpose--mixed--64x64")]
    assert {source.name: splits for source, splits in made.splits.items() if splits} == {"moving": ("test",)}


def test_weights_of_a_folder_stand_beside_the_models(register, tmp_path: Path):
    register(extra=("att",))
    (tmp_path / "model.safetensors").write_bytes(b"1")
    made = plan("plane-dbscan", fit_source=MIXED, weights=(Weights("net", tmp_path, "mine"),))
    assert {(key.model, key.fit_track) for key in made.keys} == {
        (name, "mixed") for name in ("plane-dbscan", "mine", "mine-att")
    }
    (job,) = (job for job in made.jobs if job.model == "net")
    assert (job.checkpoint, job.training_seconds, job.seed) == (tmp_path, 0.0, 0)


def test_rows_of_other_weights_never_mix(tmp_path: Path):
    def keys_of(weights: bytes, **facts: object) -> tuple[RunKey, ...]:
        (tmp_path / "model.safetensors").write_bytes(weights)
        return plan("plane-dbscan", weights=(Weights("obpose", tmp_path, "mine"),), **facts).keys

    assert keys_of(b"1") == keys_of(b"1", seconds=3.0) != keys_of(b"2")


def test_models_that_learn_nothing_run_beside_them_as_ever():
    made = plan("obpose", "plane-dbscan", fit_source=MIXED, pretrained=True)
    assert sorted(job.model for job in made.jobs) == ["obpose", *["plane-dbscan"] * 3]
    assert plan("plane-dbscan", fit_source=MIXED).jobs == tuple(job for job in made.jobs if job.model != "obpose")


def test_keys_are_sorted_and_those_of_further_segmentations_differ_in_the_name_alone(register):
    register(extra=("att",))
    keys = plan().keys
    assert keys == tuple(sorted(keys))
    assert len({dataclasses.replace(key, model="") for key in keys}) == 3


KEY = RunKey("data", "data", "m", 0, 1, "c", "f", "t")
MINUTES_20 = STARTING_SECONDS + OVERHEAD * 1200


def job(**facts: object) -> Job:
    made = Job("m", 0, Path("d"), 5, (Target(KEY, Path("d"), 5),), Path("o"), seconds=1200.0, folder=Path("f"))
    return dataclasses.replace(made, **facts)


@pytest.mark.parametrize(("seeds", "workers", "rounds"), [(1, 1, 1), (3, 2, 2), (4, 2, 2), (3, 1, 3), (2, 4, 1)])
def test_the_duration_of_trainings_that_run_side_by_side(seeds: int, workers: int, rounds: int):
    found = estimate(Plan((), (job(),) * seeds, {}), workers)
    assert found
    assert found.training == pytest.approx(rounds * MINUTES_20)


def test_the_duration_includes_scenes_and_scores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path))
    found = estimate(Plan((), (job(),) * 3, {MOVING: ("train",)}), 2)
    assert found
    data = STARTING_SECONDS + SIZES["train"] * SCENE_SECONDS / 2
    assert (found.data, found.training, found.scoring) == pytest.approx((data, 2 * MINUTES_20, 2 * SCORING_SECONDS))
    assert str(found) == (
        "This takes about 50 minutes, less if a run is resumed: 2 to make scenes, 46 to train, 2 to score."
    )


def test_the_paper_s_tables_have_a_duration_and_no_row_takes_an_hour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path))
    request = request_of(Run(model=("paper", "plane-dbscan"), track=("paper",), seeds=2, out=tmp_path / "out"))
    made = make_plan(request, [], tmp_path / "out")
    learning = [job for job in made.jobs if job.learns]
    assert len(learning) == 7 * 4 * 2
    found = estimate(made, 2)
    assert found
    assert found.training == pytest.approx(len(learning) / 2 * learning[0].training_seconds)
    alone = [estimate(Plan((), (job,), {}), 1) for job in learning]
    assert max(one.training + one.scoring for one in alone if one) < 3600


def test_the_duration_is_unknown_for_steps_and_not_given_without_training():
    assert estimate(Plan((), (job(seconds=float("inf"), steps=10),), {}), 2) is None
    assert estimate(Plan((), (job(folder=None),), {}), 2) is None
    assert estimate(Plan((), (), {}), 2) is None
