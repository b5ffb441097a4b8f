"""CPU time of whole commands, their processes included: python -m tests.perf.command_costs."""

import os
import resource
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

COMMANDS = (
    "obpose-bench --help",
    "obpose-segment --help",
    "obpose-edit infer --help",
    "obpose-train --help",
    "obpose-datagen verify --help",
    "obpose-datagen --help",
    "obpose-datagen render --help",
    "obpose-view --help",
    "obpose-bench --list",
    "obpose-bench compare obpose contact-masks --run docs/results",
    "obpose-bench --model obpose --pretrained --seeds 1",
)
BENCH = "obpose-bench --model"
"""Beginning of the command that writes a folder."""


def main() -> None:
    """Run the commands in the root of the repository, and print a line for each."""
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as place:
        for command in COMMANDS:
            output = ["--out", place] if command.startswith(BENCH) else []
            before, variables = children_seconds(), {**os.environ, "PATH": path}
            subprocess.run([*shlex.split(command), *output], check=True, stdout=subprocess.DEVNULL, env=variables)
            print(f"{children_seconds() - before:6.2f} s  {command}", flush=True)


def children_seconds() -> float:
    """CPU seconds of all child processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
