"""Entry point of `obpose-bench`."""

from datagen.console.command_line import start


def main() -> int:
    """Run `obpose-bench` and return its exit code."""
    return start("obpose-bench", "benchmark.commands.cli")
