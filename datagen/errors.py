"""Errors that the user can fix, and the exit codes of all commands."""

import difflib
from collections.abc import Iterable

EXIT_OK = 0
EXIT_USAGE = 2
EXIT_INCOMPLETE = 3
EXIT_VERIFICATION = 4
EXIT_INTERRUPTED = 130


_OUT_OF_MEMORY = ("out of memory", "not enough memory", "can't allocate memory")


class DatagenError(Exception):
    """A failure with one clear message for the user: what was wrong, what was expected, what to do."""

    exit_code = EXIT_INCOMPLETE


class UsageError(DatagenError):
    """The request itself is wrong: an unknown name, settings that contradict each other, a foreign file."""

    exit_code = EXIT_USAGE


class Busy(UsageError):
    """Another process is at work on the same files."""


class ImpossibleScene(UsageError):
    """No scene that satisfies the recipe was found within the allowed number of attempts."""


class NoTable(UsageError):
    """The frames show no table."""


class CorruptFile(DatagenError):
    """A file that is truncated, damaged or not of our format."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> UsageError:
    """Error about an unknown name; it suggests the nearest known one."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? There" if near else "there"
    return UsageError(f"Unknown {kind} {name!r}; {hint} are: {', '.join(names)}.")


def is_out_of_memory(error: Exception) -> bool:
    """Whether an error of Python or PyTorch means too little memory; on CPUs, PyTorch raises a plain RuntimeError."""
    said = str(error).lower()
    return isinstance(error, MemoryError) or any(words in said for words in _OUT_OF_MEMORY)
