"""How like the truth a model's pictures are: of the view that it was given, and of views that it was not.

python -m benchmark.studies.creation.views_cli --track moving        re-rendered, as there is one view
python -m benchmark.studies.creation.views_cli --track static        and novel views
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.ranking.leaderboard import Line
from benchmark.ranking.statistics import draw, summarise
from benchmark.studies.claims.command import run_command
from benchmark.studies.creation.subject import Subject
from benchmark.studies.creation.views import CARRIED, COPIED, FLAT, MEAN, MODEL, Likeness, measure_views
from datagen.errors import EXIT_OK
from datagen.storage.reader import Dataset

PROGRAM = "python -m benchmark.studies.creation.views_cli"
MEANS = ("psnr", "psnr_objects", "ssim")
INTERVALS = ("psnr", "psnr_objects")
"""Of the means those that get a 95 % interval, over scenes drawn anew."""
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
    measured = lines(list(found), values.refine)
    refined = f", refined in {values.refine} steps" if values.refine else ""
    place = f"first {values.scenes} scenes of the split {values.split} of {values.source.name}"
    print(f"{origin.name}{refined}, {place}:\n")
    for row in table(measured):
        print(row)
    values.write_csv(origin, measured)
    return EXIT_OK


def lines(found: Sequence[Likeness], refinements: int) -> list[Line]:
    """Of each kind of picture and who makes it: means over pictures, medians of depth over all of their pixels.

    Args:
        found: All pictures.
        refinements: Steps in which the model's scenes were refined.
    """
    groups = {
        (same_view, maker): [one for one in found if one.same_view == same_view and one.maker == maker]
        for same_view in (True, False)
        for maker in (MODEL, FLAT, CARRIED, COPIED, MEAN)
    }
    return [
        {
            "picture": "the input view" if same_view else "another view",
            "by": maker,
            "refinements": refinements if maker == MODEL else 0,
            "pictures": len(group),
            **{name: float(np.nanmean([getattr(one, name) for one in group])) for name in MEANS},
            **{key: value for name in INTERVALS for key, value in _interval(group, name).items()},
            **{name: float(np.median(np.concatenate([getattr(one, name) for one in group]))) for name in MEDIANS},
        }
        for (same_view, maker), group in groups.items()
        if group
    ]


def _interval(group: Sequence[Likeness], name: str) -> dict[str, float]:
    """Of a mean over pictures, by drawing scenes: pictures of one scene are no independent ones."""
    members = [
        [getattr(one, name) for one in group if one.scene == scene] for scene in {one.scene: None for one in group}
    ]
    counts = np.array([[np.sum(~np.isnan(scores)) for scores in members]], float)
    means = np.array([[np.nansum(scores) for scores in members]]) / np.maximum(counts, 1)
    found = summarise(means, counts, draw(1, len(members), np.random.default_rng(0)))
    return {f"{name}_ci_low": found.low, f"{name}_ci_high": found.high}


def table(measured: Sequence[Line]) -> Iterator[str]:
    """As Markdown."""
    columns = ("picture of", "by", "pictures", "PSNR (95 % over scenes)", "on objects", "SSIM", "depth error, median")
    yield f"| {' | '.join(columns)} | on objects |"
    yield "|---|---|---:|---:|---:|---:|---:|---:|"
    for line in measured:
        quality = " | ".join([*(_with_interval(line, name) for name in INTERVALS), f"{line['ssim']:.3f}"])
        depth = " | ".join(f"{1000 * float(line[name]):.1f} mm" for name in MEDIANS)
        yield f"| {line['picture']} | {line['by']} | {line['pictures']} | {quality} | {depth} |"


def _with_interval(line: Line, name: str) -> str:
    return f"{line[name]:.1f} dB ({line[f'{name}_ci_low']:.1f} to {line[f'{name}_ci_high']:.1f})"


if __name__ == "__main__":
    raise SystemExit(main())
