"""Entry points of `obpose-segment` and `obpose-edit`.

They answer `--version` at once, and handle Ctrl-C during the imports, which take seconds.
"""

from datagen.console.command_line import answer_version
from obpose.errors import EXIT_OK, interruptible_imports


def segment() -> None:
    """Run `obpose-segment` and leave with its exit code."""
    if answer_version("obpose-segment"):
        return
    with interruptible_imports("obpose-segment"):
        from obpose.commands.segment import main
    main()


def edit() -> int:
    """Run `obpose-edit` and give its exit code."""
    if answer_version("obpose-edit"):
        return EXIT_OK
    with interruptible_imports("obpose-edit"):
        from obpose.commands.edit import main
    return main()
