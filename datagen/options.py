"""What the command line's words mean: sizes, splits, shares of the work, and which recipe is asked for."""

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path

from datagen.config import Recipe, constant_names, load_recipe
from datagen.errors import UsageError
from datagen.schema import EDITS, SPLITS, EditKind
from datagen.spec import split_sizes


def parse_resolution(text: str) -> tuple[int, int]:
    """Width and height of `128x96`.

    Raises:
        UsageError: it is not of that form, or too small or large.
    """
    match = re.fullmatch(r"(\d+)[x×](\d+)", text)
    if not match:
        raise UsageError(f"--resolution {text}: expected width x height in pixels, such as 128x128.")
    width, height = int(match[1]), int(match[2])
    if not (8 <= width <= 4096 and 8 <= height <= 4096):
        raise UsageError(f"--resolution {text}: width and height must lie between 8 and 4096 pixels.")
    return width, height


def parse_splits(scenes: int | None, split: str | None) -> dict[str, int]:
    """Scenes of each split, of either `--scenes 1000` or `--split train=2000,val=100,test=300`.

    Raises:
        UsageError: neither or both are given, or they are not of that form.
    """
    if (scenes is None) == (split is None):
        raise UsageError("Give either --scenes N, which is split 80/10/10, or --split train=A,val=B,test=C.")
    if scenes is not None:
        if scenes < 1:
            raise UsageError(f"--scenes {scenes}: expected at least 1.")
        return split_sizes(scenes)
    pairs = re.findall(r"(\w+)=(\d+)(?:,|$)", split or "")
    sizes = {name: int(number) for name, number in pairs}
    if ",".join(f"{name}={number}" for name, number in pairs) != split or len(sizes) < len(pairs):
        raise UsageError(f"--split {split}: expected such as train=2000,val=100,test=300.")
    if unknown := set(sizes) - set(SPLITS):
        raise UsageError(f"--split {split}: unknown {', '.join(sorted(unknown))}; there are {', '.join(SPLITS)}.")
    if not any(sizes.values()):
        raise UsageError(f"--split {split}: expected at least one scene.")
    return sizes


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
    match = re.fullmatch(r"(\d+)/(\d+)", "0/1" if text is None else text)
    if not match or not int(match[1]) < int(match[2]):
        raise UsageError(f"--shard {text}: expected i/n with i from 0 to n-1, such as 0/4 to 3/4 for four jobs.")
    return int(match[1]), int(match[2])


def parse_workers(workers: int | None) -> int:
    """Number of processes: as many as this process may use cores, if None.

    Raises:
        UsageError: it is not positive.
    """
    if workers is not None and workers < 1:
        raise UsageError(f"--workers {workers}: expected at least 1.")
    from joblib import cpu_count  # late: help needs no engine

    return workers or cpu_count()


def choose_recipe(name: str | None, *, video: bool) -> Recipe:
    """The recipe of that name; without a name `moving` for videos and `static` for stills.

    Raises:
        UsageError: there is no such recipe, or it makes stills where videos are asked for.
    """
    recipe = load_recipe(name or ("moving" if video else "static"))
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
