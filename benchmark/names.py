"""Rules for the names of models, which become parts of file names and cells of tables."""

import re
from collections.abc import Collection

from datagen.errors import UsageError
from datagen.storage.portable_names import EXPECTED, is_portable, shown

PRETRAINED = "-pretrained"
"""Suffix for models whose weights were not trained in the run."""
SLOTS = "-{}-slots"
"""Suffix for models with another number of object slots than the track's."""
ATTENTION = "-att"
"""Suffix for the attention masks of our own models."""
REFINED = "-refined"
"""Suffix for edited scenes that were fitted to their frames first."""
REFERENCES = "references"
"""Model name in the rows of edits that need no model."""

_RESERVED = re.compile(rf".*({PRETRAINED}|{ATTENTION}|{REFINED}|{SLOTS.format('[0-9]+')})|{REFERENCES}")


def check_model_name(name: str, advice: str) -> None:
    """Check a model's name; `advice` is how to choose another one.

    Raises:
        UsageError: it cannot be part of a file name, or has the form of the names that the benchmark makes itself.
    """
    check_row_name(name, advice)
    if _RESERVED.fullmatch(name.casefold()):
        raise UsageError(
            f"{name!r} is a name that the benchmark gives itself; expected a name other than {REFERENCES!r} that does "
            f"not end in {PRETRAINED}, {ATTENTION}, {REFINED} or {SLOTS.format('N')}. {advice}"
        )


def check_row_name(name: str, advice: str) -> None:
    """Check the name of a row of tables, which may be derived from a model's name.

    Raises:
        UsageError: it cannot be part of a file name.
    """
    if not is_portable(name):
        raise UsageError(f"{shown(name)} cannot be a model's name, which is part of file names; {EXPECTED}. {advice}")


def find_twin(name: str, taken: Collection[str]) -> str | None:
    """Find a name that differs at most in case; some file systems ignore case."""
    return next((other for other in taken if other.casefold() == name.casefold()), None)
