import csv
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from benchmark.commands.train import ari_fg
from obpose.errors import CorruptFile, Diverged, Interrupted, UsageError
from obpose.storage.checkpoint import TrainingState, load, save_training
from obpose.trainable import Trainable
from obpose.training.loop import Status, Trained, train
from obpose.types import Observation
from tests.obpose.toy import QuietToy, ToyClips, ToyModel, toy_config
from tests.paths import ROOT
from tests.processes import errors_at_end, wait_until

TORCHRUN = (sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2")


def run(folder: Path | None = None, *, source=None, val_source=None, build=ToyModel, report=None, **changes) -> Trained:
    source = ToyClips() if source is None else source
    report = report or (lambda status: None)
    return train(
        source,
        val_source,
        toy_config(**changes),
        folder=folder,
        report=report,
        score=ari_fg,
        device="cpu",
        build=build,
    )


def assert_same_weights(one: Trained, other: Trained) -> None:
    for (name, value), twin in zip(one.model.state_dict().items(), other.model.state_dict().values(), strict=True):
        assert torch.equal(value, twin), name


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def interrupted_at(step: int):
    """A report that sends SIGTERM after a step."""

    def report(status: Status) -> None:
        if status.step == step:
            signal.raise_signal(signal.SIGTERM)

    return report


class Choosy(ToyModel):
    """Toy model that cannot learn from five clips."""

    def check_source(self, source):
        if len(source) == 5:
            raise UsageError("five clips")


def test_only_the_clips_of_training_are_checked():
    assert run(source=ToyClips(4), val_source=ToyClips(5), build=Choosy).steps == 6
    with pytest.raises(UsageError, match="five clips"):
        run(source=ToyClips(5), build=Choosy)


def test_the_seed_decides_everything():
    torch.manual_seed(1)
    one = run()
    torch.manual_seed(2)
    assert_same_weights(one, run())
    other = run(**{"train.seed": 1})
    assert not torch.equal(one.model.state_dict()["mean"], other.model.state_dict()["mean"])


def test_whoever_looks_sees_the_model_at_every_validation_and_changes_nothing():
    seen = []

    def look(model: Trainable, step: int, seconds: float) -> None:
        seen.append((model.training, step, seconds))
        torch.rand(3)

    one = train(ToyClips(), ToyClips(), toy_config(), device="cpu", build=ToyModel, look=look)
    assert seen == [(False, point.step, point.seconds) for point in one.curve]
    assert_same_weights(one, run(val_source=ToyClips()))


def test_the_global_generator_is_left_alone():
    torch.manual_seed(7)
    expected = torch.rand(3)
    torch.manual_seed(7)
    run()
    assert torch.equal(torch.rand(3), expected)


def test_it_learns():
    totals = []
    run(report=lambda status: totals.append(status.losses["total"]), **{"train.steps": 30, "train.learning_rate": 0.1})
    assert sum(totals[-5:]) < 0.6 * sum(totals[:5])


@pytest.mark.parametrize("step", [1, 3, 5])
def test_a_run_that_was_stopped_goes_on_exactly(tmp_path: Path, step: int):
    val = ToyClips(labels=True)
    whole = run(tmp_path / "whole", val_source=val)
    with pytest.raises(Interrupted, match=f"SIGTERM after step {step}"):
        run(tmp_path / "parts", val_source=val, report=interrupted_at(step))
    assert load(tmp_path / "parts", ToyModel)[2]["step"] == step
    parts = run(tmp_path / "parts", val_source=val)
    assert_same_weights(whole, parts)
    assert [point.losses for point in whole.curve] == [point.losses for point in parts.curve]
    one, other = (rows(tmp_path / name / "training.csv") for name in ("whole", "parts"))
    assert [int(row["step"]) for row in other] == [1, 2, 3, 4, 5, 6]
    for first, second in zip(one, other, strict=True):
        assert {**first, "seconds": 0} == {**second, "seconds": 0}


def test_a_run_that_is_done_does_nothing_more(tmp_path: Path):
    first = run(tmp_path)
    second = run(tmp_path, report=lambda status: pytest.fail("a step was made"))
    assert_same_weights(first, second)
    assert (second.steps, second.seconds) == (6, first.seconds)


def test_a_checkpoint_that_does_not_say_how_far_it_came_is_damaged(tmp_path: Path):
    weights, whole = run(tmp_path).model.state_dict(), {"processes": 1, "step": 3, "seconds": 1.0, "curve": []}
    point = {"step": 1, "seconds": 0.5, "losses": {"total": 1.0}, "ari_fg": None}
    for change in (
        {"seconds": None},
        {"step": True},
        {"step": -1},
        {"step": "3"},
        {"processes": 0},
        {"seconds": -1.0},
        {"curve": None},
        {"curve": [3]},
        {"curve": [{"step": 1}]},
        {"curve": [{**point, "more": 1}]},
        {"curve": [{**point, "losses": {"total": "1"}}]},
        {"curve": [{**point, "losses": {}}]},
        {"curve": [{**point, "losses": [1]}]},
        {"curve": [{**point, "ari_fg": "high"}]},
    ):
        save_training(tmp_path, TrainingState(weights, {}, {**whole, **change}))
        with pytest.raises(CorruptFile, match="does not say how far it came"):
            run(tmp_path)
    save_training(tmp_path, TrainingState(weights, {}, {**whole, "curve": [point]}))
    with pytest.raises(CorruptFile, match="lacks the state of the optimiser"):
        run(tmp_path)


def test_validation_changes_nothing(tmp_path: Path):
    alone = run()
    watched = run(tmp_path, val_source=ToyClips(labels=True))
    assert_same_weights(alone, watched)
    assert len(watched.curve) == 6
    assert watched.curve[0].ari_fg == 0.0  # two objects in one slot
    assert alone.curve == ()


def test_labels_never_reach_the_model():
    class Curious(ToyModel):
        def losses(self, observation: Observation, **options) -> dict[str, Tensor]:
            assert not hasattr(observation, "segmentation")
            return super().losses(observation, **options)

    assert_same_weights(run(source=ToyClips(labels=True), build=Curious), run())


def test_a_run_leaves_curves_and_pictures(tmp_path: Path):
    run(tmp_path, val_source=ToyClips(labels=True))
    training, validation = rows(tmp_path / "training.csv"), rows(tmp_path / "validation.csv")
    assert list(training[0]) == ["step", "seconds", "learning_rate", "gradient_norm", "total", "colour", "spread"]
    assert training[0]["spread"] == ""  # of the warm-up
    assert float(training[0]["learning_rate"]) == 1e-3
    assert 0 < float(training[-1]["learning_rate"]) < 1e-4
    assert [row["step"] for row in validation] == list("123456")
    assert float(validation[-1]["ari_fg"]) == 0
    pictures = sorted(path.name for path in (tmp_path / "pictures").iterdir())
    assert pictures == [f"step-{step:07d}.png" for step in range(1, 7)]


def test_a_model_is_told_how_far_the_budget_is_used_up():
    told: list[float] = []

    class Listening(ToyModel):
        def losses(self, observation: Observation, *, fraction: float, **options) -> dict[str, Tensor]:
            told.append(fraction)
            return super().losses(observation, fraction=fraction, **options)

    run(build=Listening, **{"train.steps": 4})
    assert told == [0, 0.25, 0.5, 0.75]


class Breaking(ToyModel):
    """A term is nan in the fifth step."""

    def losses(self, observation: Observation, *, step: int, **options) -> dict[str, Tensor]:
        terms = super().losses(observation, step=step, **options)
        if step == 4:
            broken = terms["spread"] * float("nan")
            terms |= {"total": terms["total"] + broken, "spread": broken}
        return terms


def test_numbers_that_are_not_finite_stop_the_run_before_they_reach_the_weights(tmp_path: Path):
    with pytest.raises(Diverged, match=r"step 5: among the losses spread is nan.*learning_rate"):
        run(tmp_path, build=Breaking)
    model = load(tmp_path, ToyModel)[0]
    assert all(value.isfinite().all() for value in model.state_dict().values())


class Bursting(ToyModel):
    """Its losses are finite in training and not on validation clips."""

    def losses(self, observation: Observation, **options) -> dict[str, Tensor]:
        terms = super().losses(observation, **options)
        return terms if torch.is_grad_enabled() else terms | {"total": terms["total"] * float("inf")}


def test_losses_on_validation_clips_that_are_not_finite_stop_the_run_too(tmp_path: Path):
    with pytest.raises(Diverged, match="by step 1: among the losses on validation clips total is inf"):
        run(tmp_path, build=Bursting, val_source=ToyClips(labels=True), **{"train.steps": 1, "train.warmup": 0})


def test_only_steps_use_up_a_budget_of_time():
    burnt = 0.02

    def burn(status: Status) -> None:
        end = time.process_time() + burnt
        while time.process_time() < end:
            pass

    begin = time.process_time()
    trained = run(report=burn, **{"train.steps": None, "train.minutes": 0.01 / 60})
    assert 0.01 <= trained.seconds < time.process_time() - begin - trained.steps * burnt


def test_without_clips_there_is_nothing_to_learn():
    with pytest.raises(UsageError, match="no clips"):
        run(source=ToyClips(clips=0))


@pytest.mark.parametrize(("seconds", "saved"), [(-1.0, [0, 1, 2, 3, 4]), (180.0, [0, 0, 0, 0, 4])])
def test_a_checkpoint_is_written_whenever_the_last_one_is_old(tmp_path: Path, seconds: float, saved: list[int]):
    found: list[int] = []

    def look(_: Status | None = None) -> None:
        found.append(load(tmp_path, ToyModel)[2]["step"])

    config, options = toy_config(**{"train.steps": 4}), {"device": "cpu", "build": ToyModel, "report": look}
    train(ToyClips(), None, config, folder=tmp_path, save_seconds=seconds, **options)
    look()
    assert found == saved


def test_signals_are_left_alone_without_a_folder():
    before = signal.getsignal(signal.SIGTERM)
    seen = []
    run(report=lambda status: seen.append(signal.getsignal(signal.SIGTERM)))
    assert set(seen) == {before}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run that nothing ended."""
    folder = tmp_path_factory.mktemp("unbroken") / "whole"
    toy_process(folder, steps=30)
    return folder


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(("number", "code", "saved"), [(signal.SIGTERM, 130, 8), (signal.SIGKILL, -9, 0)])
def test_a_process_that_is_ended_goes_on_exactly(whole: Path, tmp_path: Path, number: int, code: int, saved: int):
    table = tmp_path / "parts" / "training.csv"
    toy_process(tmp_path / "parts", steps=30, seconds=0.1, meanwhile=ending(table, number), code=code)
    assert saved <= int(load(tmp_path / "parts", QuietToy)[2]["step"]) < 30
    toy_process(tmp_path / "parts", steps=30)
    first, second = (load(folder, QuietToy)[0].state_dict() for folder in (whole, tmp_path / "parts"))
    for name, value in first.items():
        assert torch.equal(value, second[name]), name
    for name in ("training.csv", "validation.csv"):
        one, other = ([{**row, "seconds": ""} for row in rows(run / name)] for run in (whole, tmp_path / "parts"))
        assert one == other


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_processes_do_what_one_does_with_the_doubled_batch_and_stop_together(tmp_path: Path):
    toy_process(tmp_path / "one", steps=30, batch=4)
    table = tmp_path / "two" / "training.csv"
    # The launcher's own exit code, whatever that of its processes.
    toy_process(
        tmp_path / "two", steps=30, seconds=0.1, python=TORCHRUN, meanwhile=ending(table, signal.SIGTERM), code=1
    )
    assert 8 <= int(load(tmp_path / "two", QuietToy)[2]["step"]) < 30
    toy_process(tmp_path / "two", steps=30, python=TORCHRUN)
    one, two = (rows(tmp_path / name / "training.csv") for name in ("one", "two"))
    assert len(one) == len(two) == 30
    for first, second in zip(one, two, strict=True):
        for name in ("total", "colour", "gradient_norm"):
            assert float(first[name]) == pytest.approx(float(second[name]), rel=1e-4)


def ending(table: Path, number: int) -> Callable[[subprocess.Popen[str]], None]:
    """Sends a signal once the table of a run has eight rows."""

    def end(process: subprocess.Popen[str]) -> None:
        wait_until(lambda: table.exists() and len(table.read_text().splitlines()) > 8, seconds=240, what="eight steps")
        process.send_signal(number)

    return end


def toy_process(
    folder: Path,
    *,
    steps: int,
    batch: int = 2,
    seconds: float = 0.0,
    python: tuple[str, ...] = (sys.executable,),
    meanwhile: Callable[[subprocess.Popen[str]], None] = lambda process: None,
    code: int = 0,
) -> None:
    """Train in a process of its own, which must end with that exit code."""
    command = [*python, "-m", "tests.obpose.toy", str(folder), str(steps), str(batch), str(seconds)]
    environment = {"PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1", "PYTHONFAULTHANDLER": "1"}
    process = subprocess.Popen(
        command, cwd=ROOT, env=environment, text=True, stderr=subprocess.PIPE, start_new_session=True
    )
    try:
        meanwhile(process)
    except AssertionError:
        assert not errors_at_end(process, seconds=0)
        raise
    errors = errors_at_end(process)
    assert process.returncode == code, errors
