"""A bar for the scenes of a track that are made before a training."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from datagen.console.text import counted


@contextmanager
def scene_bar(console: Console, track: str, total: int) -> Iterator[Callable[[], None]]:
    """Show the progress of so many scenes where the console is a terminal; gives what is to be called after each."""
    console.print(f"Making track {track}: {counted(total, 'scene')}")
    columns = (TextColumn("scenes"), BarColumn(), MofNCompleteColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=total)
        yield lambda: bar.advance(task)
