"""Progress of a training: a bar with losses and time left, and a line for each validation."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console

from datagen.console.progress import training_bar
from obpose.training.loop import CurvePoint, Report, Status

SMOOTHING = 0.98
"""Share of the previous value in the running mean of each loss; single steps are too noisy to read."""


@contextmanager
def progress_bar(console: Console) -> Iterator[Report]:
    """Show every status that is reported; the bar appears on terminals only."""
    smooth: dict[str, float] = {}
    last: CurvePoint | None = None
    with training_bar(console) as update:

        def report(status: Status) -> None:
            nonlocal last
            if status.validation and status.validation != last:
                last = status.validation
                console.print(validation_line(last), highlight=False)
            for name, value in status.losses.items():
                smooth[name] = SMOOTHING * smooth.get(name, value) + (1 - SMOOTHING) * value
            losses = " ".join(f"{name} {smooth[name]:.3f}" for name in status.losses)
            update(status.step, status.fraction, losses)

        yield report


def validation_line(point: CurvePoint) -> str:
    """Describe one validation in one line."""
    score = "" if point.ari_fg is None else f", ARI-FG {point.ari_fg:.3f}"
    total = point.losses["total"]
    return f"step {point.step}, {point.seconds / 60:.1f} minutes: validation loss {total:.4f}{score}"
