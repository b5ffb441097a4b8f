"""Errors that users can fix, and the exit codes of all commands."""

from datagen.errors import (
    EXIT_INCOMPLETE,
    EXIT_INTERRUPTED,
    EXIT_OK,
    Busy,
    CorruptFile,
    DatagenError,
    UsageError,
    is_out_of_memory,
    unknown_name,
)

__all__ = [
    "EXIT_INCOMPLETE",
    "EXIT_INTERRUPTED",
    "EXIT_OK",
    "Busy",
    "CorruptFile",
    "DatagenError",
    "Diverged",
    "Interrupted",
    "UsageError",
    "is_out_of_memory",
    "unknown_name",
]


class Diverged(DatagenError):
    """Training produced numbers that are not finite."""


class Interrupted(DatagenError):
    """Somebody asked the training to stop; it can go on later."""

    exit_code = EXIT_INTERRUPTED
