"""Entry point of `obpose-bench`: answers `--version` at once, and handles Ctrl-C during the imports."""

from datagen.console.command_line import answer_version
from datagen.errors import interruptible_imports


def main() -> None:
    """Run the command and leave with its exit code."""
    if answer_version("obpose-bench"):
        return
    with interruptible_imports("obpose-bench"):
        from benchmark.commands.cli import main as run
    run()
