"""Where `obpose-edit` begins."""

import signal
import subprocess
import sys
from pathlib import Path

from datagen.errors import EXIT_INTERRUPTED, EXIT_OK
from tests.processes import wait_until

COMMAND = [sys.executable, "-m", "obpose.edit_command", "--help"]


def test_it_runs_the_command():
    done = subprocess.run(COMMAND, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (EXIT_OK, "")
    assert "infer, sample" in done.stdout


def test_ctrl_c_during_the_imports_is_one_line():
    with subprocess.Popen(COMMAND, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        # PyTorch's libraries are mapped while it is being imported.
        maps = Path(f"/proc/{process.pid}/maps")
        wait_until(lambda: "libtorch" in maps.read_text(), seconds=60, what="the import of PyTorch")
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=60)
    assert (process.returncode, output) == (EXIT_INTERRUPTED, "")
    assert errors == "obpose-edit: Interrupted before anything was done.\n"
