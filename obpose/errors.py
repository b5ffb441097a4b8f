"""What can go wrong in a way the user can mend, and the exit codes that all our commands share."""

from datagen.errors import (
    EXIT_INCOMPLETE,
    EXIT_INTERRUPTED,
    EXIT_OK,
    CorruptFile,
    DatagenError,
    UsageError,
)

__all__ = [
    "EXIT_INCOMPLETE",
    "EXIT_INTERRUPTED",
    "EXIT_OK",
    "CorruptFile",
    "DatagenError",
    "Diverged",
    "Interrupted",
    "UsageError",
    "is_out_of_memory",
]

_OUT_OF_MEMORY = ("out of memory", "not enough memory", "can't allocate memory")


def is_out_of_memory(error: Exception) -> bool:
    """Whether that is what an error of Python or PyTorch says; on a CPU PyTorch has no class of its own for it."""
    said = str(error).lower()
    return isinstance(error, MemoryError) or any(words in said for words in _OUT_OF_MEMORY)


class Diverged(DatagenError):
    """Training produced numbers that are not finite."""


class Interrupted(DatagenError):
    """Somebody asked the training to stop; it can go on later."""

    exit_code = EXIT_INTERRUPTED
