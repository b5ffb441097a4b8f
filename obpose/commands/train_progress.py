"""How a training goes, for whoever watches: a bar with losses and time left, and a line for each validation."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from obpose.training.loop import CurvePoint, Report, Status

SMOOTHING = 0.98
"""Share of the old value in the losses that are shown; single steps differ too much to be read."""
_WINDOW_SECONDS = 120.0
"""The time left is estimated from the speed over so long."""


@contextmanager
def progress_bar(console: Console) -> Iterator[Report]:
    """Show every status that is reported; the bar only where the console is a terminal."""
    columns = (
        TextColumn("step {task.fields[step]}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[losses]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, disable=not console.is_terminal, speed_estimate_period=_WINDOW_SECONDS
    ) as bar:
        yield _Reporter(bar, bar.add_task("", total=1.0, step=0, losses="")).show


class _Reporter:
    """Keeps what has been shown."""

    def __init__(self, bar: Progress, task: TaskID):
        self._bar, self._task = bar, task
        self._smooth: dict[str, float] = {}
        self._last: CurvePoint | None = None

    def show(self, status: Status) -> None:
        if status.validation and status.validation != self._last:
            self._last = status.validation
            self._bar.console.print(validation_line(status.validation), highlight=False)
        for name, value in status.losses.items():
            self._smooth[name] = SMOOTHING * self._smooth.get(name, value) + (1 - SMOOTHING) * value
        losses = " ".join(f"{name} {self._smooth[name]:.3f}" for name in status.losses)
        self._bar.update(self._task, completed=status.fraction, step=status.step, losses=losses)


def validation_line(point: CurvePoint) -> str:
    """One validation in words."""
    score = "" if point.ari_fg is None else f", ARI-FG {point.ari_fg:.3f}"
    total = point.losses["total"]
    return f"step {point.step}, {point.seconds / 60:.1f} minutes: validation loss {total:.4f}{score}"
