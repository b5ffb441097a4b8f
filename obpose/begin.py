"""Where those commands begin whose imports take seconds, in which Ctrl-C may come."""

from obpose.errors import interruptible_imports


def train() -> int:
    """Run `obpose-train`; give its exit code."""
    with interruptible_imports("obpose-train"):
        from obpose.cli import main
    return main()


def segment() -> None:
    """Run `obpose-segment`; leave with its exit code."""
    with interruptible_imports("obpose-segment"):
        from obpose.segment_cli import main
    main()


def edit() -> int:
    """Run `obpose-edit`; give its exit code."""
    with interruptible_imports("obpose-edit"):
        from obpose.edit_cli import main
    return main()
