"""The command `obpose-bench`: score segmentation models on tracks and keep the results in one folder.

obpose-bench --model training-free --track moving static      compare models
obpose-bench --model plane-dbscan --data DIR                   on a dataset of your own
obpose-bench --predictions DIR --track moving                  score label maps made elsewhere
obpose-bench --task editing --model obpose --pretrained --track clevr3d     score edits of inferred scenes
obpose-bench rescore RUN                                       compute all scores anew from stored label maps
obpose-bench compare A B                                       is A better than B, and what could be seen at all?
obpose-bench report RUN                                        write tables and report again
obpose-bench pack RUN --out DIR                                compress results, to publish them
obpose-bench selftest                                          check the metrics against golden cases
"""

import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from benchmark.commands import actions
from benchmark.commands.arguments import Compare, Pack, Report, Rescore, Run, Selftest
from datagen.console.command_line import Command, run_command

PROGRAM = "obpose-bench"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    kept = "Interrupted; finished rows are kept, the same command again goes on."
    with _termination_is_an_interrupt():
        return run_command(PROGRAM, COMMANDS, description=__doc__, default="run", arguments=arguments, interrupted=kept)


@contextmanager
def _termination_is_an_interrupt() -> Iterator[None]:
    """Let SIGTERM, which schedulers send, do what Ctrl-C does: trainings save how far they are."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


COMMANDS = {
    "run": Command(Run, actions.run),
    "rescore": Command(Rescore, actions.rescore),
    "compare": Command(Compare, actions.compare),
    "report": Command(Report, actions.report),
    "pack": Command(Pack, actions.pack),
    "selftest": Command(Selftest, actions.selftest),
}

if __name__ == "__main__":
    sys.exit(main())
