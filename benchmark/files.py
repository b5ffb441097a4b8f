"""Files that are there whole or not at all."""

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from datagen.errors import DatagenError


def write_whole(path: Path, data: bytes) -> None:
    """Write a file such that whoever looks sees all of it or what was there before, even after a crash.

    Raises:
        DatagenError: it cannot be written, for example because the disk is full.
    """
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".partial", dir=path.parent)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        raise DatagenError(
            f"Cannot write {path}: {error.strerror}. Finished rows are intact; mend this and run the same command."
        ) from None
    finally:
        if temporary:
            with suppress(OSError):
                os.unlink(temporary)
