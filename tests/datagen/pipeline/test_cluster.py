"""Dask clusters of two worker processes on this machine; workers and the scheduler are killed midway."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import pytest

from datagen.config import recipe_to_dict
from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, EXIT_USAGE, Busy, ImpossibleScene, UsageError
from datagen.meshes.library import Library
from datagen.pipeline import shards
from datagen.pipeline.cluster import connected
from datagen.pipeline.make_scene import SceneMaker, Source
from datagen.storage.manifest import read_manifest
from datagen.storage.spec import Compression, make_spec
from tests.paths import ROOT
from tests.processes import errors_at_end, wait_until
from tests.worlds.dask_workers import DaskWorkers
from tests.worlds.generated import RESOLUTION, compressions, hashes, make, random_spec, recipe

pytest.importorskip("distributed")

SCENES = 12
FLAGS = ("--video", "--frames=2", "--objects.minimum=1", "--objects.maximum=2", "--resolution=16x16")
CLIENT = """
import sys
from contextlib import nullcontext
from datagen.storage import spec
from datagen.pipeline import shards
from datagen.commands.cli import main
spec._MOST_SCENES_PER_SHARD = 2
if sys.argv[1] == "apart":  # workers find no mark in the folder, as if they did not share it
    shards.shared_mark = lambda folder: nullcontext(folder / "nowhere")
sys.exit(main(sys.argv[2:]))
"""
BENCH = """
import sys
from contextlib import nullcontext
from benchmark.execution import on_cluster
from benchmark.commands.cli import main
if sys.argv[1] == "apart":
    on_cluster.shared_mark = lambda folder: nullcontext(folder / "nowhere")
sys.exit(main(sys.argv[2:]))
"""


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[DaskWorkers]:
    (tmp_path / "dask").mkdir()
    made = DaskWorkers(tmp_path / "dask", 2)
    yield made
    made.end()


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset, made by one process."""
    folder = tmp_path_factory.mktemp("alone") / "set"
    process = client(folder, "--workers=1")
    errors = errors_at_end(process)
    assert process.returncode == EXIT_OK, errors
    return folder


def client(folder: Path, *flags: str, place: str = "shared", code: str = CLIENT) -> subprocess.Popen[str]:
    if code is CLIENT:
        flags = (*FLAGS, f"--split=test={SCENES},val=2", *flags)
    command = [sys.executable, "-c", code, place, *flags, "--out", str(folder)]
    return subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def check_same(folder: Path, alone: Path) -> None:
    """Equal scenes; where HDF5 places them inside a file may differ."""
    assert sorted(path.name for path in folder.iterdir()) == sorted(path.name for path in alone.iterdir())
    made, expected = (read_manifest(place) for place in (folder, alone))
    assert made is not None
    assert expected is not None
    assert made["content_hash"] == expected["content_hash"]
    assert hashes(folder) == hashes(alone)


@pytest.mark.slow
@pytest.mark.parametrize(("place", "compression"), [("shared", "gzip"), ("apart", "lz4")])
def test_a_lost_worker_loses_no_scene(
    cluster: DaskWorkers, alone: Path, tmp_path: Path, place: str, compression: Compression
):
    if compression == "lz4":
        pytest.importorskip("hdf5plugin")
    folder = tmp_path / "set"
    process = client(folder, f"--dask={cluster.address}", f"--compression={compression}", place=place)
    wait_until(lambda: list(folder.glob("*.h5")), seconds=200, what="a first shard")
    lost = cluster.workers[0]
    lost.kill()
    # What it would leave if it died while it wrote. This test does not wait for it, so that its number stays taken.
    (folder / f".test-00000.h5.partial-{socket.gethostname()}-{lost.pid}-{lost.pid}").touch()
    errors = errors_at_end(process)
    assert process.returncode == EXIT_OK, errors
    check_same(folder, alone)
    assert compressions(folder) == {compression}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_same_command_continues_after_the_scheduler_or_the_client_was_lost(
    cluster: DaskWorkers, alone: Path, tmp_path: Path
):
    folder = tmp_path / "set"
    process = client(folder, f"--dask={cluster.address}")
    wait_until(lambda: list(folder.glob("*.h5")), seconds=200, what="a first shard")
    cluster.end()
    cluster.begin()
    errors = errors_at_end(process)
    assert process.returncode == EXIT_INCOMPLETE, errors
    assert "gone or was restarted. Finished work is kept" in errors
    there = len(list(folder.glob("*.h5")))
    process = client(folder, f"--dask={cluster.address}")
    wait_until(lambda: len(list(folder.glob("*.h5"))) > there, seconds=200, what="another shard")
    process.send_signal(signal.SIGKILL)
    process.communicate()
    process = client(folder, f"--dask={cluster.address}")
    errors = errors_at_end(process)
    assert process.returncode == EXIT_OK, errors
    check_same(folder, alone)


@pytest.mark.slow
def test_workers_whose_arithmetic_differs_are_refused(cluster: DaskWorkers, tmp_path: Path):
    cluster.end()
    cluster.begin(OPENBLAS_CORETYPE="Sandybridge")
    process = client(tmp_path / "set", f"--dask={cluster.address}")
    assert "start workers with OPENBLAS_CORETYPE=Haswell" in errors_at_end(process)
    assert process.returncode == EXIT_USAGE
    assert not (tmp_path / "set").exists()


def test_workers_whose_renderer_differs_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    maker, task = SceneMaker(random_spec(train=1)), shards.ShardTask("train", 0, range(0), range(1))
    arithmetic = shards.arithmetic_of(maker.spec)
    monkeypatch.setattr(shards, "renderer_identity", lambda name, _: {"name": name, "version": 1, "engine": "llvm"})
    with pytest.raises(UsageError, match=r"it has .* and renderer raster 1 llvm; expected .* and renderer raster 1\."):
        shards.make_shard(task, maker=maker, mark=tmp_path / "nowhere", arithmetic=arithmetic)


def test_other_hosts_see_a_young_mark_during_a_long_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    class Slow:
        def map(self, _do: object, tasks: list[shards.ShardTask], *, mark: Path, **_shared: object):
            for task in tasks:
                os.utime(mark, (0, 0))
                yield task, None

    monkeypatch.setattr(shards, "connected", lambda address: nullcontext(Slow()))
    tasks = [shards.ShardTask("train", number, range(0), range(1)) for number in range(2)]
    made = shards.make_on_cluster(SceneMaker(random_spec(train=2)), tasks, "tcp://host:1", tmp_path, lambda: None)
    for _ in made:
        (mark,) = tmp_path.iterdir()
        assert time.time() - mark.stat().st_mtime < 60
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_benchmark_gives_the_same_scores_though_a_worker_is_lost(cluster: DaskWorkers, alone: Path, tmp_path: Path):
    flags = ("--model", "one-cluster", "random-slots", "--seeds", "2", "--data", str(alone))
    process = client(tmp_path / "alone", *flags, code=BENCH)
    errors = errors_at_end(process)
    assert process.returncode == EXIT_OK, errors
    process = client(tmp_path / "run", *flags, "--dask", cluster.address, place="apart", code=BENCH)
    wait_until(lambda: list(tmp_path.glob("run/runs/*.json")), seconds=200, what="a first row")
    cluster.workers[0].kill()
    errors = errors_at_end(process)
    assert process.returncode == EXIT_OK, errors
    for kind in ("scenes", "runs"):
        names = [sorted(path.name for path in (tmp_path / run / kind).glob("[!.]*")) for run in ("run", "alone")]
        assert names[0] == names[1]
    for path in (tmp_path / "alone" / "scenes").iterdir():
        assert (tmp_path / "run" / "scenes" / path.name).read_bytes() == path.read_bytes()


@pytest.mark.parametrize(("error", "calls"), [(ImpossibleScene, 1), (Busy, 3), (OSError, 3)])
def test_only_errors_that_may_pass_are_retried(local_cluster: str, tmp_path: Path, error: type[Exception], calls: int):
    def fail(log: Path) -> None:
        with log.open("a") as file:
            file.write("called ")
        raise error("no")

    with connected(local_cluster) as cluster, pytest.raises(error, match="no"):
        list(cluster.map(fail, [tmp_path / "log"]))
    assert (tmp_path / "log").read_text() == calls * "called "


def test_threads_of_a_worker_make_the_same_scenes(local_cluster: str, tmp_path: Path):
    sizes = {"train": 6, "val": 6, "test": 6}  # a shard for each of three threads
    make(tmp_path / "threads", sizes, dask=local_cluster)
    make(tmp_path / "alone", sizes)
    check_same(tmp_path / "threads", tmp_path / "alone")


def test_workers_look_for_inputs_under_absolute_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    spec = make_spec(recipe_to_dict(recipe()), seed=0, splits={}, resolution=RESOLUTION, renderer=None)
    maker = SceneMaker(spec, Source(Path("set"), ""), Library(Path("meshes"), ())).with_absolute_paths()
    assert maker.source
    assert maker.meshes
    assert [maker.source.folder, maker.meshes.folder] == [tmp_path / "set", tmp_path / "meshes"]
    (tmp_path / "set").mkdir()
    with pytest.raises(UsageError, match=f"does not see {tmp_path / 'meshes'}"):
        maker.check_inputs()
    (tmp_path / "meshes").mkdir()
    maker.check_inputs()


def test_without_a_scheduler_the_command_says_how_to_start_one():
    with (
        pytest.raises(UsageError, match="no scheduler answers there"),
        connected("tcp://127.0.0.1:9", seconds=0.2),
    ):
        pass


@pytest.mark.parametrize("address", ["", "host", "tcp://", "tcp://host:port", "http://host:80"])
def test_a_malformed_address_is_refused_before_dask_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str
):
    monkeypatch.setattr("distributed.Client", lambda *_, **__: pytest.fail("a client was started"))
    with pytest.raises(UsageError, match=f"--dask '{address}': no scheduler answers there"):
        make(tmp_path, {"train": 1}, renderer=None, dask=address)
