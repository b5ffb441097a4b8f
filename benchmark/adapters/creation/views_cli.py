"""How like the truth a model's pictures are: of the view that it was given, and of views that it was not.

python -m benchmark.adapters.creation.views_cli --track moving        re-rendered, as there is one view
python -m benchmark.adapters.creation.views_cli --track static        and novel views
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.adapters.claims.command import run_command
from benchmark.adapters.creation.subject import Subject
from benchmark.adapters.creation.views import CARRIED, COPIED, MEAN, MODEL, Likeness, measure_views
from datagen.errors import EXIT_OK
from datagen.storage import Dataset

PROGRAM = "python -m benchmark.adapters.creation.views_cli"


@dataclass(frozen=True)
class Arguments(Subject):
    """Options of the command."""

    scenes: int = 30
    """How many of them, from the first on."""
    frames: int = 3
    """Of each clip, spread evenly."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; give the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """Of one model and dataset."""
    values.check(scenes=1, frames=1)
    origin = values.origin()
    folder = values.folder()
    if Dataset(folder).views > 1:
        values.folder(("train",))
    found = list(measure_views(origin, folder, values.split, scenes=values.scenes, frames=values.frames))
    print(f"{origin.name}, first {values.scenes} scenes of the split {values.split} of {values.source.name}:\n")
    for line in table(found):
        print(line)
    return EXIT_OK


def table(found: Sequence[Likeness]) -> Iterator[str]:
    """Means over pictures, medians of depth over all of their pixels, as Markdown."""
    yield "| picture of | by | pictures | PSNR | on objects | SSIM | depth error, median | on objects |"
    yield "|---|---|---:|---:|---:|---:|---:|---:|"
    for same_view in (True, False):
        for maker in (MODEL, CARRIED, COPIED, MEAN):
            if group := [one for one in found if one.same_view == same_view and one.maker == maker]:
                yield f"| {'the input view' if same_view else 'another view'} | {maker} | {' | '.join(_cells(group))} |"


def _cells(group: Sequence[Likeness]) -> list[str]:
    means = [np.nanmean([getattr(one, name) for one in group]) for name in ("psnr", "psnr_objects", "ssim")]
    return [
        str(len(group)),
        f"{means[0]:.1f} dB",
        f"{means[1]:.1f} dB",
        f"{means[2]:.3f}",
        _median(one.depth_errors for one in group),
        _median(one.depth_errors_objects for one in group),
    ]


def _median(errors: Iterable[np.ndarray]) -> str:
    return f"{1000 * np.median(np.concatenate(list(errors))):.1f} mm"


if __name__ == "__main__":
    raise SystemExit(main())
