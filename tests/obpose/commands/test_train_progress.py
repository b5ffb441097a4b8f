import io

from rich.console import Console

from obpose.commands.train_progress import progress_bar, validation_line
from obpose.training.loop import CurvePoint, Status

POINT = CurvePoint(120, 90.0, {"total": 1.25, "air": 0.5}, 0.875)


def shown(*statuses: Status, terminal: bool) -> str:
    file = io.StringIO()
    console = Console(file=file, force_terminal=terminal, width=150, soft_wrap=True)
    with progress_bar(console) as report:
        for status in statuses:
            report(status)
    return file.getvalue()


def status(step: int, total: float = 2.0, validation: CurvePoint | None = None) -> Status:
    return Status(step, 1.0, step / 200, {"total": total, "air": 0.5}, validation)


def test_a_terminal_shows_losses_and_time_left():
    text = shown(status(1), status(100), terminal=True)
    for part in ("step 100", "50 %", "total 2.000", "air 0.500", "left"):
        assert part in text


def test_losses_are_smoothed():
    assert "total 2.020" in shown(status(1, 2.0), status(2, 3.0), terminal=True)


def test_a_file_gets_a_line_for_each_validation_and_nothing_else():
    text = shown(status(1), status(120, validation=POINT), status(121, validation=POINT), terminal=False)
    assert text.strip() == validation_line(POINT)


def test_a_validation_in_words():
    assert validation_line(POINT) == "step 120, 1.5 minutes: validation loss 1.2500, ARI-FG 0.875"
    unlabelled = CurvePoint(120, 90.0, {"total": 1.25}, None)
    assert validation_line(unlabelled) == "step 120, 1.5 minutes: validation loss 1.2500"
