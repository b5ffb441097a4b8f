"""Rules for the names of models, which become parts of file names and cells of tables."""

import re
from collections.abc import Collection, Iterable

from datagen.errors import UsageError
from datagen.storage.portable_names import EXPECTED, is_portable, shown

PRETRAINED = "-pretrained"
"""Suffix for models whose weights were not trained in the run."""
SLOTS = "-{}-slots"
"""Suffix for models with another number of object slots than the track's."""
ATTENTION = "-att"
"""Suffix for the attention masks of our own models."""
DENSITY = "-density"
"""Suffix for the labels by density of models that take their masks from elsewhere."""
REFINED = "-refined"
"""Suffix for edited scenes that were fitted to their frames first."""
REFERENCES = "references"
"""Model name in the rows of edits that need no model."""

SUFFIXES = {
    PRETRAINED: "weights that were trained before this run",
    SLOTS.format("N"): "N object slots, in place of the track's number",
    ATTENTION: "second segmentation of the same model: its attention masks, or the masks of each image alone",
    DENSITY: "second segmentation of the same model: labels by the field that is densest at each pixel's surface",
    REFINED: "scenes were fitted to their frames before the edit",
}
"""Meanings of the suffixes, which can be combined."""

_SUFFIX = re.compile("(" + "|".join(SUFFIXES).replace("N", "[0-9]+") + ")$", re.IGNORECASE)


def check_model_name(name: str, advice: str) -> None:
    """Check a model's name; `advice` is how to choose another one.

    Raises:
        UsageError: it cannot be part of a file name, or has the form of the names that the benchmark makes itself.
    """
    check_row_name(name, advice)
    if name.casefold() == REFERENCES or suffixes_of(name):
        *others, last = SUFFIXES
        raise UsageError(
            f"{name!r} is a name that the benchmark gives itself; expected a name other than {REFERENCES!r} that does "
            f"not end in {', '.join(others)} or {last}. {advice}"
        )


def check_row_name(name: str, advice: str) -> None:
    """Check the name of a row of tables, which may be derived from a model's name.

    Raises:
        UsageError: it cannot be part of a file name.
    """
    if not is_portable(name):
        raise UsageError(f"{shown(name)} cannot be a model's name, which is part of file names; {EXPECTED}. {advice}")


def suffixes_of(name: str) -> list[str]:
    """List the `SUFFIXES` of a row's name.

    >>> suffixes_of("obpose-4-slots-att")
    ['-N-slots', '-att']
    """
    if not (found := _SUFFIX.search(name)):
        return []
    return [*suffixes_of(name[: found.start()]), re.sub("[0-9]+", "N", found[0].casefold())]


def explain_suffixes(names: Iterable[str]) -> list[str]:
    """Explain the suffixes that occur in names of rows, one line each."""
    there = {suffix for name in names for suffix in suffixes_of(name)}
    return [f"{suffix} in a name: {meaning}." for suffix, meaning in SUFFIXES.items() if suffix in there]


def base_name(name: str) -> str:
    """Name of the model behind a row: the row's name without its `SUFFIXES`.

    >>> base_name("obpose-contact-pretrained-density")
    'obpose-contact'
    """
    found = _SUFFIX.search(name)
    return base_name(name[: found.start()]) if found else name


def find_twin(name: str, taken: Collection[str]) -> str | None:
    """Find a name that differs at most in case; some file systems ignore case."""
    return next((other for other in taken if other.casefold() == name.casefold()), None)
