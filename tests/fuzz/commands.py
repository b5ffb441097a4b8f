"""The commands as functions of this process: what a user calls, and the classes that load datasets.

Everything is imported when it is first called, so that a group of inputs pays for what it uses.
"""

import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from typing import Any

from datagen.console.command_line import run_program
from datagen.schema import SPLITS


def run_command(words: list[str]) -> tuple[int | None, str]:
    """Run a command; give its exit code and an empty text, or None and the traceback of what it raised."""
    try:
        code = COMMANDS[words[0]](words[1:])
        return (0 if code is None else int(code)), ""
    except SystemExit as leaving:
        return (leaving.code if isinstance(leaving.code, int) else 1 if leaving.code else 0), ""
    except BaseException:
        return None, traceback.format_exc()


def _datagen(arguments: list[str]) -> int:
    from datagen.commands.cli import main

    return main(arguments)


def _train(arguments: list[str]) -> int:
    from obpose.commands.train import main

    return main(arguments)


def _segment(arguments: list[str]) -> int:
    from benchmark.commands.segment import find_method
    from obpose.commands.segment import main

    return main(arguments, find_method=find_method)


def _edit(arguments: list[str]) -> int:
    from obpose.commands.edit_arguments import main

    return main(arguments)


def _bench(arguments: list[str]) -> int:
    from benchmark.commands.cli import main
    from tests.processes import in_this_process

    # A process of its own would hide a traceback as the reason of a failed row.
    with in_this_process():
        return main(arguments)


def _view(arguments: list[str]) -> int:
    """Do the work of `obpose-view` before it serves a page."""
    import tyro

    from obpose.commands.view import PROGRAM, Arguments
    from obpose.viewer.scene_io import open_path

    def run() -> int:
        values = tyro.cli(Arguments, args=arguments)
        open_path(values.path, checkpoint=values.checkpoint, data=values.data, split=values.split, index=values.scene)
        return 0

    return run_program(PROGRAM, run)


def _load(arguments: list[str]) -> int:
    """Read every array of a dataset with both classes that load them."""
    from datagen.storage.reader import Dataset
    from obpose.data.datasets import SceneDataset

    def run() -> int:
        dataset = Dataset(arguments[0])
        dataset.check_complete()
        for split in SPLITS:
            for record in dataset.split(split):
                assert record
            clips = SceneDataset(arguments[0], split, extra=["segmentation"])
            for index in range(len(clips)):
                assert clips[index]
        return 0

    return run_program("load", run)


def _misbehave(arguments: list[str]) -> int:
    """Do what no command should, so that tests see whether it is found out; `well` is how a command should fail."""
    what, path = arguments
    return _MISBEHAVIOUR[what](path)


def _fail(message: str) -> int:
    sys.stderr.write(f"{message}\n")
    return 2


_MISBEHAVIOUR: dict[str, Callable[[str], Any]] = {
    "raise": lambda path: {}[path],
    "allocate": lambda path: len(bytearray(b"x") * 2**31),
    "sleep": lambda path: threading.Event().wait(600),
    "kill": lambda path: os.kill(os.getpid(), signal.SIGSEGV),
    "leave": lambda path: os._exit(0),
    "exit": lambda path: 1,
    "silent": lambda path: 2,
    "internal": lambda path: _fail(f"{path} is damaged: 'NoneType' object has no attribute 'x'."),
    "unnamed": lambda path: _fail("A file is damaged."),
    "long": lambda path: _fail(f"{path}\n" * 100),
    "warn": lambda path: _fail(f"{path}\n/lib/image.py:3: RuntimeWarning: invalid value"),
    "well": lambda path: _fail(f"{path} is damaged; make it again."),
}

COMMANDS: dict[str, Callable[[list[str]], int | None]] = {
    "obpose-datagen": _datagen,
    "obpose-train": _train,
    "obpose-segment": _segment,
    "obpose-edit": _edit,
    "obpose-view": _view,
    "obpose-bench": _bench,
    "load": _load,
    "misbehave": _misbehave,
}
