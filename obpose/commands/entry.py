"""Entry points of `obpose-edit` and `obpose-view`."""

import os

from datagen.console.command_line import start


def edit() -> int:
    """Run `obpose-edit` on one core, unless `OMP_NUM_THREADS` says otherwise, and return its exit code.

    Its tensors are small: more threads gain little, and on busy cores they spend most of their time waiting.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    return start("obpose-edit", "obpose.commands.edit_arguments")


def view() -> int:
    """Run `obpose-view` and return its exit code."""
    return start("obpose-view", "obpose.commands.view")
