"""Start the driver in a process of its own, where nothing of pytest is, and give what came of its inputs."""

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.fuzz.inputs import Ending
from tests.paths import ROOT


def endings_of(folder: Path, group: str, count: int, *, seconds: float = 20.0) -> list[Ending]:
    """How about so many inputs of a group ended, each within so many seconds.

    Raises:
        RuntimeError: the valid files could not be built, or a command does not succeed on them; says what was printed.
    """
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz.driver", str(folder), group, str(count), str(seconds)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )
    if done.returncode:
        raise RuntimeError(f"The driver ended with {done.returncode}:\n{done.stdout[-5000:]}")
    lines = (folder / "endings.jsonl").read_text().splitlines()
    return [Ending(**json.loads(line)) for line in lines]
