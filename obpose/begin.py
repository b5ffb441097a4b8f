"""Entry points of `obpose-train`, `obpose-segment` and `obpose-edit`.

They answer `--version` at once, and handle Ctrl-C during the imports, which take seconds.
"""

from datagen.command_line import answer_version
from obpose.errors import EXIT_OK, interruptible_imports


def train() -> int:
    """Run `obpose-train` and give its exit code."""
    if answer_version("obpose-train"):
        return EXIT_OK
    with interruptible_imports("obpose-train"):
        from obpose.cli import main
    return main()


def segment() -> None:
    """Run `obpose-segment` and leave with its exit code."""
    if answer_version("obpose-segment"):
        return
    with interruptible_imports("obpose-segment"):
        from obpose.segment_cli import main
    main()


def edit() -> int:
    """Run `obpose-edit` and give its exit code."""
    if answer_version("obpose-edit"):
        return EXIT_OK
    with interruptible_imports("obpose-edit"):
        from obpose.edit_cli import main
    return main()
