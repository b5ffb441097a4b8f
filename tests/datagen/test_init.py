"""Scenes are the same on every x86-64 CPU with AVX2: OpenBLAS is told which kernels to use."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

from tests.worlds.generated import ROOT

KERNELS = (
    "import json, datagen, numpy, scipy.linalg, threadpoolctl\n"
    "print(json.dumps([each.get('architecture') for each in threadpoolctl.threadpool_info() "
    "if each['internal_api'] == 'openblas']))"
)

needs_avx2 = pytest.mark.skipif(
    " avx2 " not in Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else True,
    reason="a CPU without AVX2 has kernels of its own",
)


@needs_avx2
@pytest.mark.parametrize("chosen", ["Nehalem", "Sandybridge", None])
def test_kernels_do_not_depend_on_what_openblas_would_choose(chosen: str | None):
    found = subprocess.run(
        [sys.executable, "-c", KERNELS], env=environment(chosen), capture_output=True, text=True, check=True
    )
    assert set(json.loads(found.stdout)) == {"Haswell"}


@needs_avx2
def test_tests_run_with_the_same_kernels_though_plugins_import_numpy():
    libraries = [each for each in threadpool_info() if each["internal_api"] == "openblas"]
    assert {each["architecture"] for each in libraries} == {"Haswell"}


@pytest.mark.slow
@needs_avx2
def test_trajectories_of_another_cpu_type_are_equal(tmp_path: Path):
    hashes = [make(tmp_path / str(chosen), chosen) for chosen in ("Nehalem", None)]
    assert hashes[0] == hashes[1]


def make(folder: Path, chosen: str | None) -> list[str]:
    """Stored hashes of scenes that are made with these kernels as OpenBLAS's choice."""
    arguments = ["--video", "--split", "train=8", "--simulate-only", "--workers", "1", "--out", str(folder)]
    command = [sys.executable, "-m", "datagen.commands.entry", *arguments]
    subprocess.run(command, env=environment(chosen), capture_output=True, check=True)
    code = (
        "import sys; from datagen.storage.reader import Dataset; scenes = Dataset(sys.argv[1]).split('train')\n"
        "print(*(scenes.hash(index) for index in range(8)))"
    )
    found = subprocess.run(
        [sys.executable, "-c", code, str(folder)], env=environment(None), capture_output=True, text=True, check=True
    )
    return found.stdout.split()


def environment(chosen: str | None) -> dict[str, str]:
    rest = {name: value for name, value in os.environ.items() if name != "OPENBLAS_CORETYPE"}
    return {**rest, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"} | (
        {} if chosen is None else {"OPENBLAS_CORETYPE": chosen}
    )
