"""Where `obpose-bench` begins: imports take seconds, in which Ctrl-C may come."""

from datagen.errors import ending


def main() -> None:
    """Run the command; leave with its exit code."""
    with ending("obpose-bench"):
        from benchmark.cli import main as run
    run()
