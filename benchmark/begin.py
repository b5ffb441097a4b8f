"""Where `obpose-bench` begins: imports take seconds, in which Ctrl-C may come."""

from datagen.errors import interruptible_imports


def main() -> None:
    """Run the command; leave with its exit code."""
    with interruptible_imports("obpose-bench"):
        from benchmark.cli import main as run
    run()
