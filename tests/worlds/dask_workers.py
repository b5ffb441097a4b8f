"""A Dask cluster of processes of this machine."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import datagen  # noqa: F401  # chooses the kernels of OpenBLAS in the environment of the workers
from tests.paths import ROOT


class DaskWorkers:
    """A scheduler and workers, whose OpenBLAS kernels are those of this process's environment."""

    def __init__(self, folder: Path, number: int):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self.port}"
        self.folder, self.number = folder, number
        self.begin()

    def begin(self, **environment: str) -> None:
        place = ("--host", "127.0.0.1", "--port", str(self.port), "--dashboard-address", "127.0.0.1:0")
        self.scheduler = self._start("scheduler", *place)
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self.folder))
        self.workers = [self._start("worker", self.address, *options, **environment) for _ in range(self.number)]

    def _start(self, kind: str, *arguments: str, **environment: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments]
        with (self.folder / "log").open("ab") as log:
            return subprocess.Popen(command, cwd=ROOT, stderr=log, stdout=log, env={**os.environ, **environment})

    def end(self) -> None:
        for process in (*self.workers, self.scheduler):
            process.kill()
            process.wait()
