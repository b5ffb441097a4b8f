"""Parse command-line values: image sizes, splits, shares of the work, and the choice of recipe."""

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

from datagen.config import Recipe, constant_names, load_recipe
from datagen.errors import UsageError
from datagen.schema import SPLITS
from datagen.storage.cameras_file import LEAST_SIDE, MOST_SIDE
from datagen.storage.spec import MOST_SCENES, split_sizes

Name = TypeVar("Name", bound=str)

MOST_SEED = 2**63 - 1

MOST_SHARES = 100_000
"""Largest number of jobs that can share the shards of a dataset."""

MOST_WORKERS = 64
"""Number of processes allowed on any machine; machines with many cores allow more, see `WORKERS_PER_CORE`."""

WORKERS_PER_CORE = 4

_MOST_DIGITS = 30
"""Number of digits from which on a number on the command line counts as beyond all limits."""


def parse_resolution(text: str) -> tuple[int, int]:
    """Parse a resolution such as `128x96` into width and height.

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
    """Parse a whole number; too many digits give a number beyond all limits, as Python rejects thousands of digits."""
    return int(digits) if len(digits) < _MOST_DIGITS else 10**_MOST_DIGITS


def parse_splits(scenes: int | None, split: str | None) -> dict[str, int]:
    """Number of scenes of each split, from either `--scenes 1000` or `--split train=2000,val=100,test=300`.

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
    """Format a number for a message; very long ones are described by their number of digits."""
    return str(number) if abs(number) < 10**_MOST_DIGITS else f"of more than {_MOST_DIGITS} digits"


def parse_names(flag: str, text: str | None, known: Sequence[Name]) -> tuple[Name, ...]:
    """Parse a list of names such as `remove,add`, and give them in the order of the known ones; None gives none.

    Raises:
        UsageError: a name is unknown.
    """
    names = [] if text is None else text.split(",")
    if unknown := [name for name in names if name not in known]:
        raise UsageError(f"{flag} {text:.80}: unknown {unknown[0]!r:.40}; expected some of {','.join(known)}.")
    return tuple(name for name in known if name in names)


def parse_shares(text: str | None) -> tuple[float, float, float] | None:
    """Parse shares of train, val and test such as `80/10/10`; None gives None.

    Raises:
        UsageError: it is not of that form, or all are zero.
    """
    if text is None:
        return None
    match = re.fullmatch(r"(\d{1,6}(?:\.\d{1,6})?)/(\d{1,6}(?:\.\d{1,6})?)/(\d{1,6}(?:\.\d{1,6})?)", text)
    if not match or not any(float(share) for share in match.groups()):
        raise UsageError(f"--assets-split {text:.40}: expected shares of train, val and test, such as 80/10/10.")
    train, val, test = (float(share) for share in match.groups())
    return train, val, test


def parse_share(text: str | None) -> tuple[int, int]:
    """Parse `i/n` into (i, n), i counted from 0; None gives (0, 1).

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
    """Number of processes; None gives the number of cores that this process may use.

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
    """Load the recipe of a given name; without a name, `moving` for videos and `static` for stills.

    Raises:
        UsageError: there is no such recipe, or it makes stills although videos are requested.
    """
    recipe = load_recipe(name if name is not None else "moving" if video else "static")
    if video and not recipe.video:
        raise UsageError(f"--video contradicts --recipe {recipe.name}, which makes stills; leave one of them out.")
    return recipe


def with_overrides(recipe: Recipe, arguments: Sequence[str]) -> Recipe:
    """Add the constants on the command line to `overrides` of a recipe with parts, so that its parts inherit them."""
    if not recipe.parts:
        return recipe
    flags = {argument.partition("=")[0].lstrip("-").replace("-", "_") for argument in arguments}
    named = [name for name in constant_names(recipe) if {name, re.sub(r"(\w+)$", r"no_\1", name)} & flags]
    added = (name for name in named if name not in recipe.overrides)
    return dataclasses.replace(recipe, overrides=(*recipe.overrides, *added))


def default_folder(recipe: str, resolution: tuple[int, int] | None, seed: int) -> Path:
    """Default folder of a dataset: `data/RECIPE-WxH-seedS`."""
    size = "{}x{}".format(*resolution) if resolution else "simulation"
    return Path("data") / f"{recipe}-{size}-seed{seed}"
