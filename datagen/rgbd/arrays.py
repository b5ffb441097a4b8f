"""Images in array files: NPY, EXR, and frames of NPZ files, with paths `FILE.npz/NAME` or `FILE.npz/NAME/NUMBER`."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from datagen.errors import CorruptFile
from datagen.storage.safe_io import exr_header, npy_shape, npz_headers, read_exr, read_npy, read_npz

Header = tuple[tuple[int, ...], np.dtype[Any]]
"""Shape and type."""


def is_array(path: Path) -> bool:
    """Whether a path names an array rather than an image file that Pillow reads."""
    return path.suffix.lower() in (".npy", ".exr") or archive_of(path) is not None


def archive_of(path: Path) -> Path | None:
    """Find the NPZ file that holds a frame; None for files of their own."""
    return next((place for place in (path.parent, path.parent.parent) if place.suffix.lower() == ".npz"), None)


def array_header(path: Path) -> Header:
    """Read shape and type without the values; raises as `read_array`."""
    if archive := archive_of(path):
        name, *number = path.relative_to(archive).parts
        shape, dtype = npz_headers(archive, [name])[name]
        return shape[len(number) :], dtype
    return exr_header(path) if path.suffix.lower() == ".exr" else npy_shape(path)


def read_array(path: Path) -> np.ndarray:
    """Read an array, or one frame of an array in an NPZ file.

    Raises:
        UsageError: it is no regular file, or the library for EXR is missing.
        CorruptFile: it is damaged or too large.
    """
    if archive := archive_of(path):
        name, *number = path.relative_to(archive).parts
        values = _member(archive, name)
        return values[int(number[0])] if number else values
    return read_exr(path) if path.suffix.lower() == ".exr" else read_npy(path)


@lru_cache(maxsize=2)
def _member(archive: Path, name: str) -> np.ndarray:
    found = read_npz(archive, [name])
    if name not in found:
        raise CorruptFile(f"{archive} has no array {name} any more.")
    return found[name]
