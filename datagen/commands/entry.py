"""Entry point of `obpose-datagen`."""

import sys

from datagen.console.command_line import start


def main() -> int:
    """Run `obpose-datagen` and return its exit code."""
    return start("obpose-datagen", "datagen.commands.cli")


if __name__ == "__main__":
    sys.exit(main())
