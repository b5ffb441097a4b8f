import csv
import re
import shutil
import subprocess
import sys
from pathlib import Path
from statistics import mean
from types import SimpleNamespace

import pytest

from benchmark.commands.train import ari_fg
from datagen.config import Objects
from datagen.errors import EXIT_INCOMPLETE, EXIT_USAGE
from datagen.tracks import Track
from obpose.baselines.obsurf.config import ObsurfConfig
from obpose.baselines.obsurf.model import Obsurf
from obpose.commands.train import main
from obpose.model.build import build_obpose
from obpose.storage.checkpoint import load, read_config
from tests.paths import ROOT
from tests.processes import errors_at_end
from tests.worlds.imported import import_balls
from tests.worlds.traced import write_dataset

SMALL = ("train.batch=1", "train.frames=2", "train.rays=32", "train.warmup=1", "model.voxels=4")
SETTINGS = [part for change in SMALL for part in ("--set", change)]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data") / "spheres", scenes=2, frames=3, size=(24, 16))


def test_a_dataset_becomes_a_run(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    run = tmp_path / "run"
    code = main(
        ["--data", str(data), "--variant", "obpose-loc", "--steps", "2", "--seed", "5", "--out", str(run), *SETTINGS],
        score=ari_fg,
    )
    out, errors = capsys.readouterr()
    assert code == 0
    assert f"{run}: 2 steps" in out
    assert "Training obpose-loc on spheres, 2 steps" in errors
    assert "step 2, 0.0 minutes: validation loss" in errors
    assert "ARI-FG" in errors
    config = read_config(run)
    assert (config.train.seed, config.train.steps, config.model.voxels) == (5, 2, 4)
    assert config.model.pose.conditioning == "location"
    assert config.model.slots == 4  # the recipe's largest number of objects
    assert 0.01 < config.model.spacing < 0.1  # measured


@pytest.mark.parametrize(("profile", "size"), [("cpu", "64x64"), ("gpu", "128x128"), ("paper", "128x128")])
def test_larger_models_get_the_larger_images_of_a_track(
    profile: str, size: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path))
    for track in (Track("moving", "cpu"), Track("moving", "gpu")):
        track.folder.mkdir(parents=True)
        (track.folder / "mine").touch()
    assert main(["--track", "moving", "--profile", profile]) == EXIT_USAGE
    assert re.search(rf"moving-{size}-\w+ holds no dataset", "".join(capsys.readouterr().err.split("\n")))


@pytest.mark.parametrize(("variant", "size", "warns"), [
    ("contact-masks", (168, 120), True), ("contact-masks", (160, 120), False), ("obpose", (168, 120), False),
])  # fmt: skip
def test_large_images_for_systems_that_group_pixels_get_a_warning(
    variant: str,
    size: tuple[int, int],
    warns: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.setattr("obpose.training.loop.train", lambda *_, **__: SimpleNamespace(steps=0, seconds=0))
    folder = write_dataset(tmp_path / "spheres", scenes=1, frames=2, size=size)
    assert main(["--data", str(folder), "--variant", variant, "--steps", "1", "--out", str(tmp_path / "run")]) == 0
    errors = capsys.readouterr().err
    assert ("Warning: images have 168x120 pixels" in errors) == warns
    assert errors.count("--resolution 160x120") == warns


def test_the_last_word_is_that_of_set(data: Path, tmp_path: Path):
    changes = ["--set", "model.spacing=0.5", "--set", "model.slots=2", "--set", "train.steps=1"]
    assert main(["--data", str(data), "--steps", "7", "--out", str(tmp_path), *SETTINGS, *changes]) == 0
    config = read_config(tmp_path)
    assert (config.model.spacing, config.model.slots, config.train.steps) == (0.5, 2, 1)


def test_another_architecture_is_trained_by_the_same_command(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    small = ["--set", "model.encoder.width=8", "--set", "model.decoder.width=8", "--set", "train.rays=32"]
    command = ["--data", str(data), "--variant", "obsurf", "--out", str(tmp_path / "run"), *small]
    assert main([*command, "--steps", "2"]) == 0
    assert "Training obsurf on spheres, 2 steps" in capsys.readouterr().err
    model, config, info = load(tmp_path / "run")
    assert isinstance(model, Obsurf)
    assert isinstance(config, ObsurfConfig)
    assert (config.model.slots, info["step"]) == (4, 2)
    assert config.model.workspace_center != ObsurfConfig().model.workspace_center  # measured
    assert (tmp_path / "run" / "pictures").exists()
    assert main([*command, "--steps", "2"]) == 0  # there is nothing left to do


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--track", "moving", "--variant", "obsurf", "--profile", "tpu"), "are: cpu, gpu, paper"),
        (("--track", "moving", "--variant", "obsurf", "--set", "model.voxels=3"), "obpose/baselines/obsurf/config.py"),
        ((), "either --track NAME or --data DIR"),
        (("--track", "moving", "--data", "x"), "either --track NAME or --data DIR"),
        (("--track", "mooving"), "did you mean 'moving'"),
        (("--track", "moving", "--variant", "obpos"), "did you mean 'obpose'"),
        (("--track", "moving", "--profile", "tpu"), "are: cpu, gpu, paper"),
        (("--track", "moving", "--minutes", "1", "--steps", "2"), "contradict"),
        (("--track", "moving", "--minutes", "0"), "--minutes 0.0: expected more than 0 and at most 5256000"),
        (("--track", "moving", "--minutes", "-1"), "--minutes -1.0: expected more than 0"),
        (("--track", "moving", "--minutes", "nan"), "--minutes nan: expected more than 0"),
        (("--track", "moving", "--minutes", "inf"), "--minutes inf: expected more than 0"),
        (("--track", "moving", "--minutes", "1e308"), "--minutes 1e+308: expected more than 0"),
        (("--track", "moving", "--steps", "0"), "--steps 0: expected more than 0 and at most 1000000000"),
        (("--track", "moving", "--steps", "1" + "0" * 30), "expected more than 0 and at most 1000000000"),
        (("--track", "moving", "--workers", "0"), "--workers 0: expected more than 0 and at most 1024"),
        (("--track", "moving", "--workers", "-1"), "--workers -1: expected more than 0"),
        (("--track", "moving", "--threads", "0"), "--threads 0: expected more than 0"),
        (("--track", "moving", "--set", "train.learning_rate=nan"), "--set train.learning_rate=nan: expected a number"),
        (("--track", "moving", "--set", "loss.air_growth=1e999"), "--set loss.air_growth=1e999: expected a number"),
        (("--track", ""), "--track is empty; expected a value"),
        (("--data", ""), "--data is empty; expected a value"),
        (("--track", "moving", "--out="), "--out is empty; expected a value"),
        (("--track", "moving", "--variant", " "), "--variant is empty; expected a value"),
        (("--track", "moving", "--seed", "-1"), "expected 0 or more"),
        (("--track", "moving", "--seed", "1" + "0" * 30), "less than 2^63"),
        (("--track", "moving", "--threads", "100000000000"), "expected more than 0 and at most 1024"),
        (("--track", "moving", "--set", "train.bach=2"), "did you mean 'train.batch'"),
        (("--data", "/nowhere"), "holds no dataset"),
    ],
)
def test_impossible_requests_end_in_one_line(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
):
    assert main(list(arguments)) == 2
    errors = capsys.readouterr().err
    assert message in errors
    assert errors.count("\n") == 1


def test_a_dataset_s_own_folder_is_no_place_for_a_run(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    own = tmp_path / "own"
    shutil.copytree(data, own)
    (own / "train-00000.h5").unlink()  # preparing it would fail
    before = sorted(path.name for path in own.iterdir())
    assert main(["--data", str(own), "--steps", "1", "--out", str(own), *SETTINGS]) == EXIT_USAGE
    assert "holds a dataset; give another --out" in capsys.readouterr().err
    assert sorted(path.name for path in own.iterdir()) == before


def test_a_dataset_without_training_scenes_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    data = write_dataset(tmp_path / "spheres", scenes={"test": 1}, frames=2, size=(24, 16))
    assert main(["--data", str(data), "--steps", "1", "--out", str(tmp_path / "run")]) == EXIT_USAGE
    errors = capsys.readouterr().err
    assert re.search(r"spheres has no training scenes; expected at least one\. .*--split train=", errors)
    assert errors.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("variant", ["obpose-contact", "contact-masks", "obsurf"])
def test_a_dataset_without_objects_says_so(variant: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    nothing = Objects(minimum=0, maximum=0)
    data = write_dataset(tmp_path / "empty", scenes=1, frames=2, size=(24, 16), spheres=0, objects=nothing)
    command = ["--data", str(data), "--steps", "1", "--variant", variant, "--out", str(tmp_path / "run")]
    assert main(command) == EXIT_USAGE
    assert "empty has no objects, only the background" in capsys.readouterr().err


def test_a_dataset_without_validation_scenes_is_trained_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    data = write_dataset(tmp_path / "spheres", scenes={"train": 1}, frames=2, size=(24, 16))
    assert (
        main(["--data", str(data), "--variant", "obpose", "--steps", "1", "--out", str(tmp_path / "run"), *SETTINGS])
        == 0
    )
    out, errors = capsys.readouterr()
    assert "run: 1 step in 0.0 minutes." in out
    assert "Training obpose on spheres, 1 step, into" in errors


def test_values_of_which_nothing_can_be_made_leave_no_run(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    run = tmp_path / "run"
    assert main(["--data", str(data), "--out", str(run), "--set", "train.steps=-3"]) == 2
    assert capsys.readouterr().err == "obpose-train: train.steps is -3; expected 1 or more.\n"
    assert not run.exists()


def test_a_place_that_cannot_be_written_is_reported_alone(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "file").touch()
    assert main(["--data", str(data), "--steps", "1", "--out", str(tmp_path / "file" / "run")]) == EXIT_INCOMPLETE
    assert capsys.readouterr().err == f"obpose-train: {tmp_path}/file/run: Not a directory.\n"


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_processes_train_the_model_as_one_does_with_the_doubled_batch(tmp_path: Path):
    """To a tolerance, as each process has noise of its own; exactly where there is none, in training/test_loop.py."""
    data = write_dataset(tmp_path / "spheres", scenes=4, frames=3, size=(24, 16))
    launcher = ("-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2")
    all_rays = ("--set", "train.rays=0", "--set", "train.warmup=8")
    one = losses_of(training(data, tmp_path / "one", more=(*all_rays, "--set", "train.batch=2"), steps=24))
    two = losses_of(training(data, tmp_path / "two", *launcher, more=all_rays, steps=24))
    assert load(tmp_path / "two", build_obpose)[2]["step"] == 24
    assert len(one) == len(two) == 24
    for name in ("total", "colour", "gradient_norm"):
        assert two[0][name] == pytest.approx(one[0][name], rel=0.02)
    for step in range(24):
        assert two[step]["total"] == pytest.approx(one[step]["total"], rel=0.15)
    late = [mean(row["total"] for row in rows[12:]) for rows in (one, two)]
    assert late[1] == pytest.approx(late[0], rel=0.04)


def losses_of(process: subprocess.Popen[str]) -> list[dict[str, float]]:
    """Rows of its table, once it has ended."""
    errors = errors_at_end(process)
    assert process.returncode == 0, errors
    out = Path(process.args[process.args.index("--out") + 1])  # pyright: ignore
    with (out / "training.csv").open(newline="") as file:
        return [{name: float(value) for name, value in row.items() if value} for row in csv.DictReader(file)]


def training(data: Path, out: Path, *python: str, more: tuple[str, ...] = (), steps: int = 30) -> subprocess.Popen[str]:
    """The command in a process of its own, with these options of Python's before its module."""
    flags = ["--data", str(data), "--variant", "obpose", "--steps", str(steps), "--out", str(out), *SETTINGS, *more]
    return subprocess.Popen(
        [sys.executable, *python, "-m", "benchmark.commands.train", *flags],
        cwd=ROOT,
        env={"PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1"},
        text=True,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )


def test_an_imported_dataset_without_masks_becomes_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = import_balls(tmp_path, masks=(), frames=2).folder
    run = tmp_path / "run"
    assert main(["--data", str(folder), "--steps", "2", "--out", str(run), *SETTINGS], score=ari_fg) == 0
    errors = capsys.readouterr().err
    assert "validation loss" in errors
    assert "ARI-FG" not in errors
    assert read_config(run).model.slots == 6  # assumed
