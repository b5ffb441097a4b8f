"""The command `obpose-bench`: score segmentation models on tracks and keep the results in one folder.

obpose-bench --model training-free --track moving static      compare models
obpose-bench --model plane-dbscan --data DIR                   on a dataset of your own
obpose-bench --predictions DIR --track moving                  score label maps made elsewhere
obpose-bench --task editing --model obpose --pretrained --track clevr3d     score edits of inferred scenes
obpose-bench rescore RUN                                       recompute all scores from stored label maps
obpose-bench compare A B                                       paired comparison of two models
obpose-bench report RUN                                        write tables and report again
obpose-bench pack RUN --out DIR                                compress results, to publish them
obpose-bench selftest                                          check the metrics against golden cases
"""

import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import tyro

from benchmark.commands import actions
from benchmark.commands.arguments import Compare, Pack, Report, Rescore, Run, Selftest
from datagen.console.command_line import given_arguments
from datagen.errors import run_program

PROGRAM = "obpose-bench"


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the console script; exits with a code of `datagen.errors`."""
    kept = "Interrupted; finished rows are kept. Run the same command again to resume."
    with _termination_is_an_interrupt():
        code = run_program(PROGRAM, lambda: _run(given_arguments(arguments)), interrupted=kept)
    sys.exit(code)


@contextmanager
def _termination_is_an_interrupt() -> Iterator[None]:
    """Treat SIGTERM, which schedulers send, like Ctrl-C, so that trainings save their state."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _run(arguments: list[str]) -> int:
    name = arguments.pop(0) if arguments and arguments[0] in COMMANDS else "run"
    kind, command = COMMANDS[name]
    program = PROGRAM if name == "run" else f"{PROGRAM} {name}"
    # The help printer only keeps empty lines.
    description = "\n\n".join(filter(None, __doc__.split("\n"))) if name == "run" and __doc__ else None
    return command(tyro.cli(kind, prog=program, args=arguments, description=description))


COMMANDS: dict[str, tuple[type, Callable[[Any], int]]] = {
    "run": (Run, actions.run),
    "rescore": (Rescore, actions.rescore),
    "compare": (Compare, actions.compare),
    "report": (Report, actions.report),
    "pack": (Pack, actions.pack),
    "selftest": (Selftest, actions.selftest),
}

if __name__ == "__main__":
    main()
