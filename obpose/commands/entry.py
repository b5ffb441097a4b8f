"""Entry points of `obpose-segment`, `obpose-edit` and `obpose-view`."""

from datagen.console.command_line import start


def segment() -> int:
    """Run `obpose-segment` and return its exit code."""
    return start("obpose-segment", "obpose.commands.segment")


def edit() -> int:
    """Run `obpose-edit` and return its exit code."""
    return start("obpose-edit", "obpose.commands.edit")


def view() -> int:
    """Run `obpose-view` and return its exit code."""
    return start("obpose-view", "obpose.commands.view")
