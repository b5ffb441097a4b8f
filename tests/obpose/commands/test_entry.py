"""Entry points of the commands: what they import before they need it, and Ctrl-C while they do."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from datagen.errors import EXIT_INTERRUPTED, EXIT_OK
from obpose.commands.edit_arguments import Infer, main
from obpose.commands.train import Train
from obpose.scenes.refine import STEPS
from obpose.storage.pretrained import shipped_names
from tests.processes import wait_until

COMMANDS = {
    "obpose-datagen": "from datagen.commands.entry import main",
    "obpose-train": "from benchmark.commands.train import main",
    "obpose-segment": "from benchmark.commands.segment import main",
    "obpose-edit": "from obpose.commands.entry import edit as main",
    "obpose-view": "from obpose.commands.entry import view as main",
    "obpose-bench": "from benchmark.commands.entry import main",
}
SUBCOMMANDS = {
    "obpose-datagen": ["render", "import", "verify", "stats", "preview", "export", "push", "regenerate", "assets"],
    "obpose-edit": ["infer", "sample", "fit-prior", "render", "mesh", "remove", "move", "rotate", "swap", "add"],
    "obpose-bench": ["rescore", "compare", "report", "pack", "selftest"],
}
SLOW = ["torch", "numba", "scipy", "sklearn", "pandas", "matplotlib", "pybullet", "PIL"]
INTERRUPTED = {
    "obpose-train": ["--data", "missing"],
    "obpose-segment": ["--rgb", "missing"],
    "obpose-edit": ["mesh", "missing", "--object", "1", "--out", "new.ply"],
    "obpose-bench": ["--list"],
}
"""Arguments with which the libraries are imported."""
LIST_MODULES = """
import contextlib, io, json, sys
{start}
codes = []
for arguments in json.loads(sys.argv[1]):
    sys.argv[1:] = arguments
    with contextlib.redirect_stdout(io.StringIO()) as output, contextlib.redirect_stderr(io.StringIO()) as errors:
        codes.append(main())
    assert (output if codes[-1] == 0 else errors).getvalue()
json.dump([codes, [*sys.modules]], sys.stdout)
"""


@pytest.mark.parametrize("program", COMMANDS)
def test_help_and_wrong_flags_import_nothing_slow(program: str):
    subcommands = SUBCOMMANDS.get(program, [])
    calls = [["--help"], *([name, "--help"] for name in subcommands), ["--nonsense"]]
    code = LIST_MODULES.format(start=COMMANDS[program])
    done = subprocess.run([sys.executable, "-c", code, json.dumps(calls)], capture_output=True, text=True, timeout=120)
    codes, modules = json.loads(done.stdout)
    assert codes[:-1] == [EXIT_OK] * (len(calls) - 1)
    assert codes[-1] != EXIT_OK
    unwanted = SLOW if program == "obpose-datagen" else [*SLOW, "numpy"]
    assert [name for name in unwanted if name in modules] == []


@pytest.mark.parametrize(("given", "threads"), [(None, 1), ("2", 2)])
def test_edits_run_on_one_core_unless_the_user_says_otherwise(given: str | None, threads: int):
    code = "from obpose.commands.entry import edit; edit(); import torch; print(torch.get_num_threads())"
    environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    environment |= {} if given is None else {"OMP_NUM_THREADS": given}
    command = [sys.executable, "-c", code, "--version"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.stdout.split()[-1] == str(threads)


def test_the_help_of_edits_names_weights_that_ship_of_the_default_model(capsys: pytest.CaptureFixture[str]):
    assert main([]) == EXIT_OK
    named = set(re.findall(r"\S+--\S+--\S+", capsys.readouterr().out))
    assert {name.split("--")[0] for name in named} == {Train.variant}
    assert named <= set(shipped_names())


def test_the_default_of_a_flag_is_that_of_the_function():
    assert Infer(checkpoint="any", out=Path("out")).refine == STEPS


@pytest.mark.parametrize("program", INTERRUPTED)
def test_ctrl_c_during_the_imports_is_one_line(program: str):
    code = f"import sys; {COMMANDS[program]}; sys.exit(main())"
    command = [sys.executable, "-c", code, *INTERRUPTED[program]]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        # NumPy's libraries are mapped early while everything is being imported.
        maps = Path(f"/proc/{process.pid}/maps")
        found = lambda: "_multiarray_umath" in maps.read_text() or process.poll() is not None  # noqa: E731
        wait_until(found, seconds=60, what="the import of NumPy")
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=60)
    assert (process.returncode, output) == (EXIT_INTERRUPTED, "")
    assert errors == f"{program}: Interrupted while it began.\n"
