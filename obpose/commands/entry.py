"""Entry points of `obpose-edit` and `obpose-view`."""

from datagen.console.command_line import start


def edit() -> int:
    """Run `obpose-edit` and return its exit code."""
    return start("obpose-edit", "obpose.commands.edit_arguments")


def view() -> int:
    """Run `obpose-view` and return its exit code."""
    return start("obpose-view", "obpose.commands.view")
