"""What people see of work that takes long, on standard error: lines, and bars where it is a terminal."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmark.tracks import Source


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
    console.print(f"Making track {source.name}: {total} scenes into {source.folder}")
    with progress_bar(console, "scenes", total) as advance:
        yield advance
