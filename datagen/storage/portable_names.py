"""Names that are safe in file names on every system and in table cells."""

import re
import unicodedata

from datagen.errors import UsageError

MOST_BYTES = 80
"""Longest name in UTF-8: a file name holds two names and may have 255 bytes."""
EXPECTED = (
    f"expected at most {MOST_BYTES} bytes of letters, digits, dots, dashes, plus signs, underscores and single spaces, "
    "the first a letter or digit"
)

_NAME = re.compile(r"[^\W_]([\w.+-]| (?! |$))*")


def is_portable(name: str) -> bool:
    """Whether a name can be part of a file name on every system."""
    return bool(
        _NAME.fullmatch(name)
        and len(name.encode()) <= MOST_BYTES
        and unicodedata.is_normalized("NFC", name)
        and not name.endswith(".")
    )


def shown(name: str) -> str:
    """Quote a name for a message; long ones are shortened."""
    return ascii(name) if len(name) <= MOST_BYTES else f"{name[:20]!a}... ({len(name)} characters)"


def check_dataset_name(name: str) -> None:
    """Check the name of a dataset's folder, which stands for the dataset in file names and tables.

    Raises:
        UsageError: it cannot be part of a file name.
    """
    if not is_portable(name):
        raise UsageError(
            f"The dataset's folder is called {shown(name)}, and its name becomes part of file names; {EXPECTED}. "
            "Rename the folder."
        )
