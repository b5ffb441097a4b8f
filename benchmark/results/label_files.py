"""Opening a run's file of label maps, which may hold poses as well."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from datagen.errors import UsageError
from datagen.storage.safe_io import open_hdf5

ADVICE = "Delete its row in runs/ and run again."


def check_labels(*paths: Path) -> None:
    """Check that files of label maps are there.

    Raises:
        UsageError: one is not.
    """
    for path in paths:
        if not path.is_file():
            raise UsageError(
                f"There is no file {path}; expected label maps that a run of obpose-bench left in its folder. "
                "Published results are without them: the run's command makes them."
            )


@contextmanager
def reading_labels(path: Path) -> Iterator[h5py.File]:
    """Open a run's file of label maps.

    Raises:
        UsageError: there is none.
        CorruptFile: it is damaged, or what is read of it.
    """
    check_labels(path)
    with open_hdf5(path, ADVICE) as file:
        yield file
