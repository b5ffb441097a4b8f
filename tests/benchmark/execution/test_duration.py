import dataclasses
from pathlib import Path

import pytest

from benchmark.commands.arguments import Run
from benchmark.execution import duration
from benchmark.execution.duration import estimate, estimate_trainings, in_words, time_limit
from benchmark.execution.plan import Plan, make_plan
from benchmark.execution.request import request_of
from benchmark.execution.runner import Job, Target
from benchmark.results.run_folder import RunKey
from datagen.tracks import SIZES, find_track

KEY = RunKey("data", "data", "m", 0, 1, "c", "f", "t")


@pytest.fixture(autouse=True)
def round_numbers(monkeypatch: pytest.MonkeyPatch):
    for name, value in {"STARTING_SECONDS": 0.0, "ASIDE": 1.0, "SCORING_SECONDS": 60.0, "SCENE_SECONDS": 0.1}.items():
        monkeypatch.setattr(duration, name, value)


def job(**facts: object) -> Job:
    made = Job("m", 0, Path("d"), 5, (Target(KEY, Path("d"), 5),), Path("o"), seconds=1200.0, folder=Path("f"))
    return dataclasses.replace(made, **facts)


@pytest.mark.parametrize(("seeds", "workers", "minutes"), [(1, 1, 20), (3, 2, 40), (4, 2, 40), (3, 1, 60), (2, 4, 20)])
def test_trainings_run_side_by_side(seeds: int, workers: int, minutes: int):
    found = estimate(Plan((), (job(),) * seeds, {}), workers)
    assert found
    assert found.training == 60 * minutes


def test_scenes_and_scores_take_time_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path))
    plan = Plan((), (job(),) * 3, {find_track("moving"): ("train",)})
    found = estimate(plan, 2)
    assert found
    assert (found.data, found.training, found.scoring) == (100.0, 2400.0, 120.0)
    assert in_words(found) == (
        "This takes about 44 minutes, less where a run goes on: 2 to make scenes, 40 to train, 2 to score."
    )


def test_all_rows_of_the_paper_s_tables_are_told_beforehand_and_none_takes_an_hour(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path))
    request = request_of(Run(model=("paper", "plane-dbscan"), track=("paper",), seeds=2, out=tmp_path / "out"))
    plan = make_plan(request, [], tmp_path / "out")
    assert len([job for job in plan.jobs if job.learns]) == 7 * 4 * 2
    found = estimate(plan, 2)
    assert found
    assert found.training == 7 * 4 * 2 * 12 * 60 / 2
    assert found.data == 4 * sum(SIZES.values()) * 0.1 / 2
    alone = [estimate(Plan((), (job,), {}), 1) for job in plan.jobs if job.learns]
    assert max(one.total for one in alone if one) < 3600


def test_trials_take_the_time_of_their_trainings_alone():
    found = estimate_trainings([job(seconds=180.0)] * 5, scenes=100, workers=2)
    assert found
    assert (found.data, found.training, found.scoring) == (5.0, 540.0, 0.0)
    assert estimate_trainings([], scenes=100, workers=2) is None
    assert estimate_trainings([job(seconds=float("inf"), steps=3)], scenes=0, workers=2) is None


def test_weights_that_ship_need_no_training():
    found = estimate(Plan((), (job(checkpoint=Path("c")),), {}), 2)
    assert found
    assert (found.training, found.total) == (0.0, 60.0)


def test_nobody_knows_how_long_steps_take_and_what_takes_seconds_needs_no_word():
    assert estimate(Plan((), (job(seconds=float("inf"), steps=10),), {}), 2) is None
    assert estimate(Plan((), (job(folder=None),), {}), 2) is None
    assert estimate(Plan((), (), {}), 2) is None


def test_the_time_limit_follows_from_the_budget():
    assert time_limit(job(folder=None)) == 3600
    assert time_limit(job()) == 3600 + 2 * 1200
    assert time_limit(job(seconds=12000.0)) == 3600 + 2 * 12000
    assert time_limit(job(seconds=float("inf"), steps=500)) == 3600 + 2 * 500
    assert time_limit(job(checkpoint=Path("c"))) == 3600
