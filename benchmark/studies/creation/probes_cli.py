"""What an object's latent holds: linear probes of z_what for shape, colour and size.

And for the object's place, which the latent should not hold.

python -m benchmark.studies.creation.probes_cli --track clevr3d
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
from jaxtyping import Float

from benchmark.ranking.leaderboard import Line
from benchmark.studies.claims.command import run_command
from benchmark.studies.creation.objects import Objects, infer_objects
from benchmark.studies.creation.probes import Probe, Sample, probe_names, probe_numbers
from benchmark.studies.creation.subject import Subject
from datagen.errors import EXIT_OK, UsageError

PROGRAM = "python -m benchmark.studies.creation.probes_cli"
LEARNED_FROM = "train"
LEAST_HEIGHT = 0.001
"""Standard deviation in metres of what is left of heights, below which there is nothing to ask for."""
MOST_COLOURS = 16
"""Up to so many colours have names, beyond which they are numbers only."""


@dataclass(frozen=True)
class Arguments(Subject):
    """Options of the command."""

    learn_scenes: int = 400
    """Training scenes on whose objects the probes learn."""


@dataclass(frozen=True)
class Row:
    """One question to the latents."""

    what: str
    measure: str
    by_latent: Probe
    by_place: Probe
    """From T_hat in place of z_what."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; give the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """Of one model and dataset."""
    values.check(scenes=1, learn_scenes=1)
    origin = values.origin()
    if values.split == LEARNED_FROM:
        raise UsageError(f"--split {LEARNED_FROM}: probes learn on it; expected val or test.")
    folder = values.folder((LEARNED_FROM,))
    learned = infer_objects(origin, folder, LEARNED_FROM, values.learn_scenes)
    tested = infer_objects(origin, folder, values.split, values.scenes)
    print(
        f"{origin.name}: {len(learned.scene)} objects of {values.learn_scenes} training scenes, {len(tested.scene)} of "
        f"{values.scenes} scenes of the split {values.split}; {tested.missed} others of these were not found.\n"
    )
    found = list(rows(learned, tested))
    for row in table(found):
        print(row)
    values.write_csv(origin, lines(found))
    return EXIT_OK


def rows(learned: Objects, tested: Objects) -> Iterator[Row]:
    """All questions."""
    yield _row("shape", "right", learned, tested, lambda objects: objects.shape)
    plain, plain_tested = _only(learned, learned.plain), _only(tested, tested.plain)
    if len(np.unique(plain.colour, axis=0)) <= MOST_COLOURS:
        yield _row("colour, of a palette", "right", plain, plain_tested, lambda objects: _names(objects.colour))
    yield _row("colour", "R²", plain, plain_tested, lambda objects: objects.colour)
    yield _row("size", "R²", learned, tested, lambda objects: objects.size)
    for axis, name in enumerate("xyz"):
        yield _row(f"position, {name}", "R²", learned, tested, partial(_coordinate, axis))
    beyond = height_beyond_shape(learned)
    if beyond(learned).std() >= LEAST_HEIGHT:
        yield _row("position, z, beyond shape and size", "R²", learned, tested, beyond)


def height_beyond_shape(learned: Objects) -> Callable[[Objects], Float[np.ndarray, "object"]]:
    """What of an object's height, metres, the line of height over size of all objects of its shape leaves over.

    Objects stand on the table, and the middles of larger ones are higher: a latent that holds shape and size holds that
    much of the height as well.
    """
    kinds = np.unique(learned.shape)

    def known(objects: Objects) -> Float[np.ndarray, "object number"]:
        is_kind = (objects.shape[:, None] == kinds).astype(float)
        return np.concatenate([is_kind, is_kind * objects.size[:, None]], axis=1)

    slopes, *_ = np.linalg.lstsq(known(learned), learned.position[:, 2], rcond=None)
    return lambda objects: objects.position[:, 2] - known(objects) @ slopes


def lines(found: Iterable[Row]) -> list[Line]:
    """For a CSV."""
    return [
        {
            "what": row.what,
            "measure": row.measure,
            "z_what": row.by_latent.score,
            "z_what_ci_low": row.by_latent.low,
            "z_what_ci_high": row.by_latent.high,
            "t_hat": row.by_place.score,
            "no_input": row.by_latent.baseline,
            "learned_from": row.by_latent.trained,
            "tested": row.by_latent.tested,
        }
        for row in found
    ]


def table(found: Iterable[Row]) -> Iterator[str]:
    """As Markdown."""
    yield "| what | measure | from z_what (95 % over scenes) | from T_hat | without either | learned from, tested |"
    yield "|---|---|---:|---:|---:|---:|"
    for row in found:
        latent, place = row.by_latent, row.by_place
        yield (
            f"| {row.what} | {row.measure} | {latent.score:.2f} ({latent.low:.2f} to {latent.high:.2f}) | "
            f"{place.score:.2f} | {latent.baseline:z.2f} | {latent.trained}, {latent.tested} |"
        )


def _row(what: str, measure: str, learned: Objects, tested: Objects, asked: Callable[[Objects], np.ndarray]) -> Row:
    probe = probe_numbers if measure == "R²" else probe_names
    by_latent, by_place = (
        probe(*(Sample(known(objects), asked(objects), objects.scene) for objects in (learned, tested)))
        for known in (lambda objects: objects.what, lambda objects: objects.place)
    )
    return Row(what, measure, by_latent, by_place)


def _coordinate(axis: int, objects: Objects) -> np.ndarray:
    return objects.position[:, axis]


def _only(objects: Objects, kept: np.ndarray) -> Objects:
    arrays = {field.name: getattr(objects, field.name) for field in fields(objects) if field.name != "missed"}
    return replace(objects, **{name: array[kept] for name, array in arrays.items()})


def _names(colours: np.ndarray) -> np.ndarray:
    return np.array([" ".join(f"{channel:.3f}" for channel in colour) for colour in colours])


if __name__ == "__main__":
    raise SystemExit(main())
