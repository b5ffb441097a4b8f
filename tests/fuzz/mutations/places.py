"""Something that is no regular file in the place of one."""

import os
from collections.abc import Sequence
from pathlib import Path

from numpy.random import Generator

from tests.fuzz.mutations.draw import Mutator, pick


def as_folder(path: Path, rng: Generator) -> str:
    """A folder in the place of the file."""
    path.unlink()
    path.mkdir()
    return "empty"


def as_pipe(path: Path, rng: Generator) -> str:
    """A pipe that nobody writes to."""
    path.unlink()
    os.mkfifo(path)
    return "without a writer"


def as_link(path: Path, rng: Generator) -> str:
    """A link to itself, to nothing, or to an endless device."""
    path.unlink()
    target = pick(rng, (str(path), "nowhere", "/dev/zero"))
    path.symlink_to(target)
    return f"to {Path(target).name}"


def gone(path: Path, rng: Generator) -> str:
    """Nothing."""
    path.unlink()
    return "deleted"


PLACES: Sequence[Mutator] = (as_folder, as_pipe, as_link, gone)
