"""The command `obpose-view`: view scenes and edit them by hand, in a browser.

obpose-view DATA                              infer test scene 0 of a dataset with shipped weights
obpose-view DATA --checkpoint RUN --scene 3   infer test scene 3 with your own model
obpose-view RUN --data DATA                   infer test scene 0 with your own model
obpose-view SCENE                             open a scene written by obpose-edit or by this page
"""

import atexit
import importlib.util
import os
import socket
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from datagen.console.command_line import Command, run_command
from datagen.console.interrupts import interruptible_imports
from obpose.errors import EXIT_INTERRUPTED, EXIT_OK, UsageError

if TYPE_CHECKING:
    from obpose.viewer.page import Page

PROGRAM = "obpose-view"
LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True)
class Arguments:
    """Serve a page to view, edit, sample and save scenes."""

    path: Annotated[Path, tyro.conf.Positional]
    """Folder of a dataset with images, of a scene, or of a trained model (or the name of shipped weights)."""
    checkpoint: str | None = None
    """For a dataset: folder of the model that infers the scene, or the name of shipped weights. Default: the shipped
    weights for its recipe, of obpose-contact if there are any. For a scene: folder of its model, if it was moved."""
    data: Path | None = None
    """For a model: folder of the dataset to infer a scene from. For a scene: folder of its dataset, to show the input
    beside it."""
    split: Literal["train", "val", "test"] = "test"
    scene: int = 0
    """Index of the scene in the split, from 0."""
    out: Path = Path("scenes")
    """Folder for saved scenes; each gets a new folder inside."""
    host: str = "127.0.0.1"
    """Address to listen at; with any but the default, others on the network can open the page, edit and save."""
    port: int = 8080


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until Ctrl-C and return the exit code."""
    return run_command(
        PROGRAM,
        Command(Arguments, run),
        description=__doc__,
        arguments=arguments,
        interrupted="Closed; unsaved edits are lost.",
        out_of_memory="Out of memory; give a dataset of shorter clips or smaller images.",
    )


def run(values: Arguments) -> int:
    """Open the path, serve the page, and wait for Ctrl-C."""
    check(values)
    page = serve(values)
    host = f"[{values.host}]" if ":" in values.host else values.host
    print(f"{PROGRAM}: http://{host}:{values.port} shows {page.title}; Ctrl-C ends it.", flush=True)
    if values.host not in LOOPBACK:
        print(f"{PROGRAM}: everyone who can reach {host} can edit, and save into {values.out}.", flush=True)
    # A normal exit of the interpreter would unwind threads of the server that still run, and abort.
    atexit.register(os._exit, EXIT_INTERRUPTED)
    try:
        threading.Event().wait()
    finally:
        page.close()
    return EXIT_OK


def check(values: Arguments, *, has_viser: bool = importlib.util.find_spec("viser") is not None) -> None:
    """Check the arguments before any slow work.

    Raises:
        UsageError: viser is missing, a number is out of range, or the address cannot be used.
    """
    if not has_viser:
        raise UsageError("The viewer needs viser and websockets; install them with: pip install 'obpose[view]'")
    if values.scene < 0:
        raise UsageError(f"--scene {values.scene}: expected 0 or more.")
    if not 0 < values.port < 65536:
        raise UsageError(f"--port {values.port}: expected 1 to 65535.")
    if values.out.exists() and not values.out.is_dir():
        raise UsageError(f"--out {values.out} is a file; expected a folder, or a place for a new one.")
    try:
        family = socket.getaddrinfo(values.host, values.port, type=socket.SOCK_STREAM)[0][0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((values.host, values.port))
    except (OSError, UnicodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no name of a host"
        raise UsageError(
            f"Cannot listen at {values.host}, port {values.port}: {reason}; give another --port or --host."
        ) from None


def serve(values: Arguments) -> "Page":
    """Open the path of the arguments and start a server with its page.

    Raises:
        UsageError: as in `obpose.viewer.scene_io.open_path`, or another process has taken the port since `check`.
    """
    # Late, because PyTorch takes seconds to import.
    with interruptible_imports(PROGRAM):
        from obpose.viewer.page import Page
        from obpose.viewer.scene_io import open_path
        from obpose.viewer.server import open_server

    place = {"checkpoint": values.checkpoint, "data": values.data, "split": values.split, "index": values.scene}
    opened = open_path(values.path, **place)
    return Page(open_server(values.host, values.port, opened.title), opened, values.out)


if __name__ == "__main__":
    sys.exit(main())
