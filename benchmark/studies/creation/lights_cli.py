"""How far the light that is found in frames is from the one that the generator rendered them with.

python -m benchmark.studies.creation.lights_cli --track moving
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.ranking.leaderboard import Line
from benchmark.studies.claims.command import run_command
from benchmark.studies.creation.subject import Subject
from datagen.errors import EXIT_OK
from datagen.storage.reader import Dataset
from obpose.scenes.appearance.light import strength
from obpose.scenes.clip import read_clip
from obpose.scenes.infer import infer_scene
from obpose.scenes.refine import STEPS

PROGRAM = "python -m benchmark.studies.creation.lights_cli"


@dataclass(frozen=True)
class Arguments(Subject):
    """Options of the command."""


@dataclass(frozen=True)
class Found:
    """In one scene."""

    strength: float
    """Share of the table's colour that is lost in shadows; 0 where no light was found."""
    degrees: float
    """Between the direction that was found and the true one; nan where none was."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; give the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """Of one model and dataset."""
    values.check(scenes=1)
    origin, folder = values.origin(), values.folder()
    records = Dataset(folder).split(values.split)
    found = []
    for index in range(min(values.scenes, len(records))):
        light = infer_scene(origin, read_clip(folder, values.split, index), refinements=STEPS).appearance.light
        # The first light of a scene casts the shadows.
        degrees = angle(light[:3].numpy(), records[index]["lights/direction"][0])
        found.append(Found(strength(light), degrees if strength(light) else float("nan")))
    for row in table(found):
        print(row)
    values.write_csv(origin, lines(found))
    return EXIT_OK


def angle(one: np.ndarray, other: np.ndarray) -> float:
    """Between two unit vectors, degrees."""
    return float(np.degrees(np.arccos(np.clip(one @ other, -1, 1))))


def table(found: Sequence[Found]) -> Iterator[str]:
    """As Markdown."""
    degrees = np.array([each.degrees for each in found if each.strength])
    strengths = [each.strength for each in found if each.strength]
    yield "| scenes | lights found | angle to the true one, median | 90 % below | largest | strength, mean |"
    yield "|---:|---:|---:|---:|---:|---:|"
    if not len(degrees):
        yield f"| {len(found)} | 0 | | | | |"
        return
    middle, most, worst = np.quantile(degrees, [0.5, 0.9, 1.0])
    yield (f"| {len(found)} | {len(degrees)} | {middle:.1f}° | {most:.1f}° | {worst:.1f}° | {np.mean(strengths):.2f} |")


def lines(found: Sequence[Found]) -> list[Line]:
    """For a CSV."""
    return [{"scene": index, "strength": each.strength, "degrees": each.degrees} for index, each in enumerate(found)]


if __name__ == "__main__":
    raise SystemExit(main())
