"""Progress bars and status lines of all commands, on standard error; bars appear on terminals only."""

from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars
from rich.text import Text

from datagen.console.text import counted

Item = TypeVar("Item")

Advance = Callable[[], None]
"""Function to call after each finished step."""

Progress = Callable[[int], AbstractContextManager[Advance]]
"""Function that starts to show progress over a number of scenes."""


@runtime_checkable
class Tracker(Protocol):
    """Function that iterates over a sequence and shows how many items are done, such as `tracked`."""

    def __call__(self, items: Sequence[Item], title: str, /) -> Iterable[Item]:
        """Iterate over the items; `title` describes the work."""
        ...


_WINDOW_SECONDS = 120.0
"""Time over which the speed of a training is averaged to estimate the time left."""


def no_progress(total: int) -> AbstractContextManager[Advance]:
    """Show nothing."""
    return nullcontext(lambda: None)


def status_console(*, quiet: bool = False) -> Console:
    """Console for status lines, on standard error."""
    return Console(stderr=True, soft_wrap=True, highlight=False, quiet=quiet)


@contextmanager
def progress_bar(console: Console, unit: str, total: int) -> Iterator[Advance]:
    """Show finished steps, steps per second and the time left; yields a function to call after each step."""
    columns = (TextColumn(unit), BarColumn(), MofNCompleteColumn(), _Speed(unit), "left", TimeRemainingColumn())
    with Bars(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("", total=total)
        yield lambda: bars.advance(task)


class _Speed(ProgressColumn):
    def __init__(self, unit: str):
        super().__init__()
        self._unit = unit

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text(f"{speed:.3g} {self._unit}/s" if speed else "")


def scene_progress(total: int) -> AbstractContextManager[Advance]:
    """Show the progress of making scenes; a `Progress`."""
    return progress_bar(status_console(), "scenes", total)


@contextmanager
def track_progress(console: Console, track: str, folder: Path, total: int) -> Iterator[Advance]:
    """Announce that the scenes of a track are made, and show the progress."""
    console.print(f"Making track {track}: {counted(total, 'scene')} into {folder}", markup=False)
    with progress_bar(console, "scenes", total) as advance:
        yield advance


def tracked(items: Iterable[Item], title: str, total: int | None = None) -> Iterator[Item]:
    """Iterate with a progress bar; the total may be left out for sequences."""
    if total is None:
        assert isinstance(items, Sized)
        total = len(items)
    with progress_bar(status_console(), title, total) as advance:
        for item in items:
            yield item
            advance()


def untracked(items: Sequence[Item], title: str) -> Iterable[Item]:
    """Iterate without showing progress; a `Tracker`."""
    return items


@contextmanager
def busy(title: str) -> Iterator[None]:
    """Show a spinner during work of unknown length."""
    with status_console().status(title):
        yield


@contextmanager
def training_bar(console: Console) -> Iterator[Callable[[int, float, str], None]]:
    """Show a training; yields a function that takes the step, the finished share of the training, and a text."""
    columns = (TextColumn("step {task.fields[step]}"), BarColumn(), TaskProgressColumn("{task.percentage:>3.0f} %"))
    times = (TimeElapsedColumn(), "left", TimeRemainingColumn())
    hidden = not console.is_terminal
    with Bars(
        *columns,
        "{task.description}",
        *times,
        console=console,
        disable=hidden,
        speed_estimate_period=_WINDOW_SECONDS,
    ) as bars:
        task = bars.add_task("", total=1.0, step=0)
        yield lambda step, share, text: bars.update(task, completed=share, step=step, description=text)
