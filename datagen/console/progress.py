"""A progress bar with scenes per second and time left."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

Advance = Callable[[], None]
"""To be called after each scene."""

Progress = Callable[[int], AbstractContextManager[Advance]]
"""Starts showing the progress of so many scenes."""


def no_progress(total: int) -> AbstractContextManager[Advance]:
    """Show nothing."""
    return nullcontext(lambda: None)


@contextmanager
def progress_bar(total: int) -> Iterator[Advance]:
    """Show a bar on stderr."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Speed(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text(f"{speed:.1f} scenes/s" if speed else "- scenes/s")

    columns = (
        TextColumn("scenes"),
        BarColumn(),
        MofNCompleteColumn(),
        Speed(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=total)
        yield lambda: bar.advance(task)
