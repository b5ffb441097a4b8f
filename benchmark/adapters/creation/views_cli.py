"""How like the truth a model's pictures are: of the view that it was given, and of views that it was not.

python -m benchmark.adapters.creation.views_cli --track moving        re-rendered, as there is one view
python -m benchmark.adapters.creation.views_cli --track static        and novel views
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.adapters.claims.command import run_command
from benchmark.adapters.creation.subject import Subject
from benchmark.adapters.creation.views import CARRIED, COPIED, FLAT, MEAN, MODEL, Likeness, measure_views
from benchmark.leaderboard import Line
from datagen.errors import EXIT_OK
from datagen.storage import Dataset

PROGRAM = "python -m benchmark.adapters.creation.views_cli"
MEANS = ("psnr", "psnr_objects", "ssim")
MEDIANS = ("depth_errors", "depth_errors_objects")


@dataclass(frozen=True)
class Arguments(Subject):
    """Options of the command."""

    scenes: int = 30
    """How many of them, from the first on."""
    frames: int = 3
    """Of each clip, spread evenly."""
    refine: int = 0
    """Steps in which the model's scenes are fitted to the input view, as `obpose-edit infer --refine` does."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; give the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """Of one model and dataset."""
    values.check(scenes=1, frames=1, refine=0)
    origin = values.origin()
    folder = values.folder()
    if Dataset(folder).views > 1:
        values.folder(("train",))
    found = measure_views(
        origin, folder, values.split, scenes=values.scenes, frames=values.frames, refinements=values.refine
    )
    measured = lines(list(found))
    refined = f", refined in {values.refine} steps" if values.refine else ""
    place = f"first {values.scenes} scenes of the split {values.split} of {values.source.name}"
    print(f"{origin.name}{refined}, {place}:\n")
    for row in table(measured):
        print(row)
    values.write_csv(origin, measured)
    return EXIT_OK


def lines(found: Sequence[Likeness]) -> list[Line]:
    """Of each kind of picture and who makes it: means over pictures, medians of depth over all of their pixels."""
    groups = {
        (same_view, maker): [one for one in found if one.same_view == same_view and one.maker == maker]
        for same_view in (True, False)
        for maker in (MODEL, FLAT, CARRIED, COPIED, MEAN)
    }
    return [
        {
            "picture": "the input view" if same_view else "another view",
            "by": maker,
            "pictures": len(group),
            **{name: float(np.nanmean([getattr(one, name) for one in group])) for name in MEANS},
            **{name: float(np.median(np.concatenate([getattr(one, name) for one in group]))) for name in MEDIANS},
        }
        for (same_view, maker), group in groups.items()
        if group
    ]


def table(measured: Sequence[Line]) -> Iterator[str]:
    """As Markdown."""
    yield "| picture of | by | pictures | PSNR | on objects | SSIM | depth error, median | on objects |"
    yield "|---|---|---:|---:|---:|---:|---:|---:|"
    for line in measured:
        quality = f"{line['psnr']:.1f} dB | {line['psnr_objects']:.1f} dB | {line['ssim']:.3f}"
        depth = " | ".join(f"{1000 * float(line[name]):.1f} mm" for name in MEDIANS)
        yield f"| {line['picture']} | {line['by']} | {line['pictures']} | {quality} | {depth} |"


if __name__ == "__main__":
    raise SystemExit(main())
