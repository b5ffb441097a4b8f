"""Where `obpose-datagen` begins: imports take a second, in which Ctrl-C may come."""

import sys

from datagen import interrupts
from datagen.errors import EXIT_INTERRUPTED


def main() -> int:
    """Run the command; give its exit code."""
    interrupts.listen()
    try:
        from datagen.cli import main as run
    except KeyboardInterrupt:
        print("obpose-datagen: Interrupted before anything was done.", file=sys.stderr)
        return EXIT_INTERRUPTED
    return run()


if __name__ == "__main__":
    sys.exit(main())
