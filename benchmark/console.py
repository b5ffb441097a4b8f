"""What people see of work that takes long, on standard error: lines, and bars where it is a terminal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmark.tracks import Source
from datagen.wording import counted

Item = TypeVar("Item")


def status() -> Console:
    """Where lines about the work go."""
    return Console(stderr=True, soft_wrap=True, highlight=False)


@contextmanager
def progress_bar(console: Console, what: str, total: int) -> Iterator[Callable[[], None]]:
    """A progress bar, where the console is a terminal; gives what is to be called at each step."""
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        yield lambda: bar.advance(task)


def watched(items: Sequence[Item], title: str) -> Iterator[Item]:
    """Give the items of a sequence, and show a progress bar on standard error where it is a terminal."""
    with progress_bar(status(), title, len(items)) as advance:
        for item in items:
            yield item
            advance()


@contextmanager
def busy(title: str) -> Iterator[None]:
    """Show on standard error, where it is a terminal, that work of unknown length is being done."""
    with status().status(title):
        yield


def prepare(splits: Mapping[Source, tuple[str, ...]], *, workers: int) -> None:
    """Make what is missing of these splits, and say so.

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
