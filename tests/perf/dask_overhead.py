"""CPU time of making scenes on a Dask cluster against one process: python -m tests.perf.dask_overhead."""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.worlds.dask_workers import DaskWorkers

FLAGS = ("--video", "--frames", "2", "--split", "train=256", "--resolution", "32x32")


def make(folder: Path, *flags: str) -> tuple[float, float]:
    """CPU and wall seconds of one command and its processes."""
    started, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "datagen.commands.entry", *FLAGS, "--out", str(folder), *flags]
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, time.monotonic() - started


def used(process: int) -> float:
    """CPU seconds that a process has used."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Print a line for one process and for each number of workers."""
    with tempfile.TemporaryDirectory() as place:
        alone, wall = make(Path(place) / "alone", "--workers", "1")
        print(f"one process: {alone:.1f} s of CPU, {wall:.1f} s of wall time", flush=True)
        for number in (1, 2, 4):
            (Path(place) / f"dask{number}").mkdir()
            cluster = DaskWorkers(Path(place) / f"dask{number}", number)
            client, wall = make(Path(place) / f"set{number}", "--dask", cluster.address)
            workers, scheduler = sum(used(worker.pid) for worker in cluster.workers), used(cluster.scheduler.pid)
            cluster.end()
            total = client + workers + scheduler
            print(
                f"{number} workers: {total:.1f} s of CPU ({total / alone:.2f}x; client {client:.1f}, scheduler "
                f"{scheduler:.1f}), {wall:.1f} s of wall time",
                flush=True,
            )


if __name__ == "__main__":
    main()
