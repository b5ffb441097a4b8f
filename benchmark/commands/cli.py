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
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from benchmark.commands.arguments import Compare, Pack, Report, Rescore, Run, Selftest
from datagen.console.command_line import Command, run_command

PROGRAM = "obpose-bench"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    kept = "Interrupted; finished rows are kept. Run the same command again to resume."
    with _termination_is_an_interrupt():
        return run_command(PROGRAM, COMMANDS, description=__doc__, default="run", arguments=arguments, interrupted=kept)


@contextmanager
def _termination_is_an_interrupt() -> Iterator[None]:
    """Treat SIGTERM, which schedulers send, like Ctrl-C, so that trainings save their state."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


COMMANDS = {
    "run": Command(Run, "benchmark.commands.actions:run"),
    "rescore": Command(Rescore, "benchmark.commands.actions:rescore"),
    "compare": Command(Compare, "benchmark.commands.actions:compare"),
    "report": Command(Report, "benchmark.commands.actions:report"),
    "pack": Command(Pack, "benchmark.commands.actions:pack"),
    "selftest": Command(Selftest, "benchmark.commands.actions:selftest"),
}

if __name__ == "__main__":
    sys.exit(main())
