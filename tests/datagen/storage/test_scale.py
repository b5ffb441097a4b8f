"""Datasets of thousands of shards: 15,625 are a million scenes. Run with -s to see the figures."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.paths import ROOT
from tests.worlds import rendered

SHARDS = 15_625

BEGIN = """
import random, sys, time
from pathlib import Path
from datagen.inspect import stats
from datagen.storage.reader import Dataset
from datagen.storage.shard import Shard
def mib():
    return int(Path("/proc/self/statm").read_text().split()[1]) / 256
folder = sys.argv[1]
"""
LINKED = "Shard._check_place = lambda self, facts, split, number: None  # all are links to the first\n"


def run(code: str, folder: Path) -> list[float]:
    command = [sys.executable, "-c", BEGIN + code, str(folder)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return [float(value) for value in result.stdout.split()]


@pytest.mark.slow
def test_a_million_scenes_open_and_are_read_at_random_in_constant_memory(tmp_path: Path):
    code = """
start = time.process_time()
scenes = Dataset(folder).split("train")
print(time.process_time() - start)
fields = ["rgb", "depth", "segmentation"]
def read(number, last):
    rng, times = random.Random(0), []
    for _ in range(number):
        start = time.process_time()
        scenes.read(rng.randrange(last), fields)
        times.append(time.process_time() - start)
    return 1e3 * sorted(times)[number // 2]
read(100, len(scenes))
before = mib()
print(read(1000, len(scenes)), read(1000, len(scenes)), mib() - before, read(1000, 640))
"""
    opened, scattered, again, growth, near = run(
        LINKED + code, rendered.write_shards(tmp_path / "set", SHARDS, linked=True)
    )
    print(f"open {opened:.3f} s; random scene {scattered:.2f} ms, of a shard that was open before {again:.2f} ms")
    print(f"in ten open shards {near:.3f} ms; growth {growth:.2f} MiB")
    assert opened < 1
    assert growth < 1


@pytest.mark.slow
def test_statistics_take_constant_memory(tmp_path: Path):
    code = "stats.summary(folder); print(mib())"
    few, many = (run(LINKED + code, rendered.write_shards(tmp_path / str(n), n, linked=True))[0] for n in (10, 150))
    print(f"statistics of 640 scenes {few:.0f} MiB, of 9600 scenes {many:.0f} MiB")
    assert many - few < 9  # 1 MiB per 1000 scenes
    assert many < 500


@pytest.mark.slow
def test_memory_stays_flat_while_scenes_are_read_in_order(tmp_path: Path):
    code = """
scenes, used = Dataset(folder).split("train"), []
for index in range(len(scenes)):
    scenes[index]
    used.append(mib())
print(used[-1] - used[127])
"""
    (growth,) = run(code, rendered.write_shards(tmp_path / "set", 32))
    print(f"reading 2048 scenes: {growth:.2f} MiB")
    assert growth < 2
