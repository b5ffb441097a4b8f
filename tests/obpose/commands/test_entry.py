"""Where the commands that take seconds to import begin."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from datagen.errors import EXIT_INTERRUPTED, EXIT_OK
from tests.processes import wait_until

COMMANDS = {
    "obpose-train": "from benchmark.commands.train import main",
    "obpose-segment": "from benchmark.commands.segment import main",
    "obpose-edit": "from obpose.commands.entry import edit as main",
    "obpose-view": "from obpose.commands.entry import view as main",
    "obpose-bench": "from benchmark.commands.entry import main",
}


def command_of(program: str) -> list[str]:
    return [sys.executable, "-c", f"import sys; {COMMANDS[program]}; sys.exit(main())", "--help"]


@pytest.mark.parametrize("program", COMMANDS)
def test_it_runs_the_command(program: str):
    done = subprocess.run(command_of(program), capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (EXIT_OK, "")
    assert program in done.stdout


@pytest.mark.parametrize("program", sorted({*COMMANDS} - {"obpose-view"}))  # its help needs no NumPy
def test_ctrl_c_during_the_imports_is_one_line(program: str):
    with subprocess.Popen(command_of(program), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        # NumPy's libraries are mapped early while everything is being imported.
        maps = Path(f"/proc/{process.pid}/maps")
        found = lambda: "_multiarray_umath" in maps.read_text() or process.poll() is not None  # noqa: E731
        wait_until(found, seconds=60, what="the import of NumPy")
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=60)
    assert (process.returncode, output) == (EXIT_INTERRUPTED, "")
    assert errors == f"{program}: Interrupted while it began.\n"
