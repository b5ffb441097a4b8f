"""Where `obpose-edit` begins: imports take seconds, in which Ctrl-C may come."""

import os
import signal
import sys
from types import FrameType

from obpose.errors import EXIT_INTERRUPTED


def main() -> int:
    """Run the command; give its exit code."""
    before = signal.signal(signal.SIGINT, _leave)
    from obpose.edit_cli import main as run

    signal.signal(signal.SIGINT, before)
    return run()


def _leave(_signal: int, _frame: FrameType | None) -> None:
    """End at once: nothing was begun, and what is raised while a library is imported may be lost in it."""
    os.write(sys.stderr.fileno(), b"obpose-edit: Interrupted before anything was done.\n")
    os._exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    sys.exit(main())
