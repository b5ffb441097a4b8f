"""Rules for the names of models and datasets, which become parts of file names and cells of tables."""

import re
import unicodedata
from collections.abc import Collection

from datagen.errors import UsageError

MOST_BYTES = 80
"""Longest name in UTF-8: a file name holds two names and may have 255 bytes."""

PRETRAINED = "-pretrained"
"""Suffix for models whose weights were not trained in the run."""
SLOTS = "-{}-slots"
"""Suffix for models with another number of object slots than the track's."""
ATTENTION = "-att"
"""Suffix for the attention masks of our own models."""
REFINED = "-refined"
"""Suffix for edited scenes that were fitted to their frames first."""
REFERENCES = "references"
"""Stands in the place of a model's name for edits that need no model."""

_NAME = re.compile(r"[^\W_]([\w.+-]| (?! |$))*")
_EXPECTED = (
    f"expected at most {MOST_BYTES} bytes of letters, digits, dots, dashes, plus signs, underscores and single spaces, "
    "the first a letter or digit"
)
_RESERVED = re.compile(rf".*({PRETRAINED}|{ATTENTION}|{REFINED}|{SLOTS.format('[0-9]+')})|{REFERENCES}")


def check_dataset_name(name: str) -> None:
    """Check the name of a dataset's folder, which stands for the dataset in file names and tables.

    Raises:
        UsageError: it cannot be part of a file name.
    """
    if not _is_portable(name):
        raise UsageError(
            f"The dataset's folder is called {_shown(name)}, and its name becomes part of file names; {_EXPECTED}. "
            "Rename the folder."
        )


def check_model_name(name: str, advice: str) -> None:
    """Check a model's name; `advice` says how to give another one.

    Raises:
        UsageError: it cannot be part of a file name, or has the form of the names that the benchmark makes itself.
    """
    check_row_name(name, advice)
    if _RESERVED.fullmatch(name.casefold()):
        raise UsageError(
            f"{name!r} is a name that the benchmark gives itself; expected another than {REFERENCES!r}, which does not "
            f"end in {PRETRAINED}, {ATTENTION}, {REFINED} or {SLOTS.format('N')}. {advice}"
        )


def check_row_name(name: str, advice: str) -> None:
    """Check the name of a row of tables, which may be one that the benchmark made of a model's name.

    Raises:
        UsageError: it cannot be part of a file name.
    """
    if not _is_portable(name):
        raise UsageError(f"{_shown(name)} cannot be a model's name, which is part of file names; {_EXPECTED}. {advice}")


def find_twin(name: str, taken: Collection[str]) -> str | None:
    """Find a name that equals this one but for upper and lower case, which some file systems take for the same."""
    return next((other for other in taken if other.casefold() == name.casefold()), None)


def _is_portable(name: str) -> bool:
    return bool(
        _NAME.fullmatch(name)
        and len(name.encode()) <= MOST_BYTES
        and unicodedata.is_normalized("NFC", name)
        and not name.endswith(".")
    )


def _shown(name: str) -> str:
    return ascii(name) if len(name) <= MOST_BYTES else f"{name[:20]!a}... ({len(name)} characters)"
