"""Errors that the user can fix, their exit codes, and how every command reports them."""

import difflib
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType

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


class CorruptFile(DatagenError):
    """A file that is truncated, damaged or not of our format."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> UsageError:
    """Error about an unknown name; it suggests the nearest known one."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? There" if near else "there"
    return UsageError(f"Unknown {kind} {name!r}; {hint} are: {', '.join(names)}.")


def run_program(
    program: str, run: Callable[[], int], *, interrupted: str = "Interrupted.", out_of_memory: str | None = None
) -> int:
    """Run a command and give its exit code; every failure that a user can mend ends in one line on stderr.

    Args:
        program: What the user called.
        run: Gives the exit code of success.
        interrupted: What to say after Ctrl-C.
        out_of_memory: What to say when there is no more memory; None lets that pass.
    """
    try:
        return run()
    except DatagenError as error:
        said, code = str(error), error.exit_code
    except KeyboardInterrupt:
        said, code = interrupted, EXIT_INTERRUPTED
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        said, code = f"{place}{error.strerror or error}.", EXIT_INCOMPLETE
    except (MemoryError, RuntimeError) as error:
        if out_of_memory is None or not is_out_of_memory(error):
            raise
        said, code = out_of_memory, EXIT_INCOMPLETE
    sys.stderr.write(f"{program}: {said}\n")
    return code


@contextmanager
def interruptible_imports(program: str) -> Iterator[None]:
    """Let Ctrl-C end the process at once, in one line: what is raised while a library is imported may be lost in it."""

    def leave(_signal: int, _frame: FrameType | None) -> None:
        os.write(sys.stderr.fileno(), f"{program}: Interrupted while it began.\n".encode())
        os._exit(EXIT_INTERRUPTED)

    before = signal.signal(signal.SIGINT, leave)
    yield
    signal.signal(signal.SIGINT, before)


def is_out_of_memory(error: Exception) -> bool:
    """Whether that is what an error of Python or PyTorch says; on a CPU PyTorch has no class of its own for it."""
    said = str(error).lower()
    return isinstance(error, MemoryError) or any(words in said for words in _OUT_OF_MEMORY)
