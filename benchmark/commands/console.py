"""Generation of missing datasets, with progress on standard error."""

from collections.abc import Mapping
from functools import partial

from datagen.console.progress import status_console, track_progress
from datagen.tracks import Source


def prepare(splits: Mapping[Source, tuple[str, ...]], *, workers: int) -> None:
    """Generate the missing scenes of these splits, and report it.

    Raises:
        DatagenError: scenes could not be made.
    """
    console = status_console()
    for source, names in splits.items():
        source.prepare(names, workers=workers, progress=partial(track_progress, console, source.name, source.folder))
