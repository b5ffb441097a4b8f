"""Where those commands begin that import PyTorch at once, which takes seconds, in which Ctrl-C may come."""

from obpose.errors import ending


def segment() -> None:
    """Run `obpose-segment`; leave with its exit code."""
    with ending("obpose-segment"):
        from obpose.segment_cli import main
    main()


def edit() -> int:
    """Run `obpose-edit`; give its exit code."""
    with ending("obpose-edit"):
        from obpose.edit_cli import main
    return main()
