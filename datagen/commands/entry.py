"""Entry point of `obpose-datagen`: answers `--version` at once, and handles Ctrl-C while libraries are imported."""

import sys

from datagen.console import interrupts
from datagen.console.command_line import answer_version
from datagen.errors import EXIT_INTERRUPTED, EXIT_OK


def main() -> int:
    """Run the command and give its exit code."""
    interrupts.listen()
    try:
        if answer_version("obpose-datagen"):
            return EXIT_OK
        from datagen.commands.cli import main as run
    except KeyboardInterrupt:
        print("obpose-datagen: Interrupted before anything was done.", file=sys.stderr)
        return EXIT_INTERRUPTED
    return run()


if __name__ == "__main__":
    sys.exit(main())
