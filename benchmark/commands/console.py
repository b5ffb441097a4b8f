"""Progress output on standard error: lines, and progress bars on a terminal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from datagen.console.text import counted
from datagen.tracks import Source

Item = TypeVar("Item")


def status() -> Console:
    """Console for status lines, on standard error."""
    return Console(stderr=True, soft_wrap=True, highlight=False)


@contextmanager
def progress_bar(console: Console, what: str, total: int) -> Iterator[Callable[[], None]]:
    """Show a progress bar if the console is a terminal; yields a function to call after each step."""
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        yield lambda: bar.advance(task)


def watched(items: Sequence[Item], title: str) -> Iterator[Item]:
    """Iterate over a sequence with a progress bar on standard error, if that is a terminal."""
    with progress_bar(status(), title, len(items)) as advance:
        for item in items:
            yield item
            advance()


@contextmanager
def busy(title: str) -> Iterator[None]:
    """Show a spinner on standard error during work of unknown length, if that is a terminal."""
    with status().status(title):
        yield


def prepare(splits: Mapping[Source, tuple[str, ...]], *, workers: int) -> None:
    """Generate the missing scenes of these splits, and report it.

    Raises:
        DatagenError: scenes could not be made.
    """
    console = status()
    for source, names in splits.items():
        source.prepare(names, workers=workers, progress=partial(_making, console, source))


@contextmanager
def _making(console: Console, source: Source, total: int) -> Iterator[Callable[[], None]]:
    console.print(f"Making track {source.name}: {counted(total, 'scene')} into {source.folder}", markup=False)
    with progress_bar(console, "scenes", total) as advance:
        yield advance
