"""What the command line's words mean: sizes, splits, shares of the work, and which recipe is asked for."""

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path

from datagen.config import Recipe, constant_names, load_recipe
from datagen.errors import UsageError
from datagen.schema import EDITS, SPLITS, EditKind
from datagen.spec import MOST_SCENES, split_sizes

LEAST_SIDE, MOST_SIDE = 8, 4096
"""Of an image, pixels."""

MOST_SEED = 2**63 - 1

MOST_SHARES = 100_000
"""Jobs that can share the shards of a dataset."""

MOST_WORKERS = 64
"""Processes that any machine may be asked for; machines with many cores allow more."""

WORKERS_PER_CORE = 4

_MOST_DIGITS = 30
"""Of a number on the command line."""


def parse_resolution(text: str) -> tuple[int, int]:
    """Width and height of `128x96`.

    Raises:
        UsageError: it is not of that form, or too small or large.
    """
    match = re.fullmatch(r"([0-9]+)[x×]([0-9]+)", text)
    if not match:
        raise UsageError(f"--resolution {text}: expected width x height in pixels, such as 128x128.")
    width, height = (_number(digits) for digits in match.groups())
    if min(width, height) < LEAST_SIDE or max(width, height) > MOST_SIDE:
        raise UsageError(
            f"--resolution {text:.40}: expected a width and a height from {LEAST_SIDE} to {MOST_SIDE} pixels."
        )
    return width, height


def _number(digits: str) -> int:
    """A whole number, or one that is beyond all limits: Python does not read numbers of thousands of digits."""
    return int(digits) if len(digits) < _MOST_DIGITS else 10**_MOST_DIGITS


def parse_splits(scenes: int | None, split: str | None) -> dict[str, int]:
    """Scenes of each split, of either `--scenes 1000` or `--split train=2000,val=100,test=300`.

    Raises:
        UsageError: neither or both are given, they are not of that form, or they are too many.
    """
    if (scenes is None) == (split is None):
        raise UsageError("Give either --scenes N, which is split 80/10/10, or --split train=A,val=B,test=C.")
    if scenes is not None:
        if not 1 <= scenes <= MOST_SCENES:
            raise UsageError(f"--scenes {_short(scenes)}: expected at least 1 and at most {MOST_SCENES:,}.")
        return split_sizes(scenes)
    pairs = re.findall(r"(\w+)=([0-9]+)(?:,|$)", split or "")
    if ",".join(f"{name}={number}" for name, number in pairs) != split or len(dict(pairs)) < len(pairs):
        raise UsageError(f"--split {split:.80}: expected such as train=2000,val=100,test=300.")
    sizes = {name: _number(digits) for name, digits in pairs}
    if unknown := set(sizes) - set(SPLITS):
        raise UsageError(f"--split {split:.80}: unknown {', '.join(sorted(unknown))}; there are {', '.join(SPLITS)}.")
    if max(sizes.values(), default=0) > MOST_SCENES:
        raise UsageError(f"--split {split:.80}: expected at most {MOST_SCENES:,} scenes in a split.")
    if not any(sizes.values()):
        raise UsageError(f"--split {split:.80}: expected at least one scene.")
    return sizes


def check_seed(seed: int) -> None:
    """Check a seed.

    Raises:
        UsageError: it is negative, or beyond what 64 bits hold.
    """
    if not 0 <= seed <= MOST_SEED:
        raise UsageError(f"--seed {_short(seed)}: expected 0 or more, and at most {MOST_SEED} (2^63 - 1).")


def _short(number: int) -> str:
    """A number for a message; one of very many digits by their count."""
    return str(number) if abs(number) < 10**_MOST_DIGITS else f"of more than {_MOST_DIGITS} digits"


def parse_edits(text: str | None) -> tuple[EditKind, ...]:
    """The edits of `remove,move,add` or some of them; none if None.

    Raises:
        UsageError: there is no such edit.
    """
    names = [] if text is None else text.split(",")
    if text is not None and (unknown := [name for name in names if name not in EDITS]):
        raise UsageError(f"--edits {text}: unknown {unknown[0]!r}; expected some of {','.join(EDITS)}.")
    return tuple(kind for kind in EDITS if kind in names)


def parse_share(text: str | None) -> tuple[int, int]:
    """(i, n) of `i/n`, i counted from 0.

    Raises:
        UsageError: it is not of that form.
    """
    text = "0/1" if text is None else text
    match = re.fullmatch(r"([0-9]+)/([0-9]+)", text)
    share, shares = (_number(digits) for digits in match.groups()) if match else (0, 0)
    if share >= shares or shares > MOST_SHARES:
        raise UsageError(
            f"--shard {text:.40}: expected i/n with i from 0 to n-1, such as 0/4 to 3/4 for four jobs; n is at most "
            f"{MOST_SHARES:,}."
        )
    return share, shares


def parse_workers(workers: int | None) -> int:
    """Number of processes: as many as this process may use cores, if None.

    Raises:
        UsageError: it is not positive, or far more than this machine has cores for.
    """
    if workers is not None and workers < 1:
        raise UsageError(f"--workers {_short(workers)}: expected at least 1.")
    from joblib import cpu_count  # late: help needs no engine

    most = max(MOST_WORKERS, WORKERS_PER_CORE * cpu_count())
    if workers is not None and workers > most:
        raise UsageError(f"--workers {_short(workers)}: expected at most {most} on this machine.")
    return workers or cpu_count()


def choose_recipe(name: str | None, *, video: bool) -> Recipe:
    """The recipe of that name; without a name `moving` for videos and `static` for stills.

    Raises:
        UsageError: there is no such recipe, or it makes stills where videos are asked for.
    """
    recipe = load_recipe(name if name is not None else "moving" if video else "static")
    if video and not recipe.video:
        raise UsageError(f"--video contradicts --recipe {recipe.name}, which makes stills; leave one of them out.")
    return recipe


def with_overrides(recipe: Recipe, arguments: Sequence[str]) -> Recipe:
    """The recipe; where it has parts, with a note of the constants that the command line names, for these to follow."""
    if not recipe.parts:
        return recipe
    flags = {argument.partition("=")[0].lstrip("-").replace("-", "_") for argument in arguments}
    named = [name for name in constant_names(recipe) if {name, re.sub(r"(\w+)$", r"no_\1", name)} & flags]
    return dataclasses.replace(recipe, overrides=tuple(named))


def default_folder(recipe: str, resolution: tuple[int, int] | None, seed: int) -> Path:
    """Where a dataset goes if nobody says so: `data/RECIPE-WxH-seedS`."""
    size = "{}x{}".format(*resolution) if resolution else "simulation"
    return Path("data") / f"{recipe}-{size}-seed{seed}"
