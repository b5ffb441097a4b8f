"""Recordings of other projects: what every importer finds, and how it gives images."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from datagen.formats.import_request import Grouping, ReadOptions
from datagen.shapes.shape import OrientedBox


@dataclass(frozen=True)
class Facts:
    """Size of a recording, known before its images are read."""

    images: int
    """Number of images over time, or of views if they are views."""
    views: int
    """Number of cameras that take each image."""
    size: tuple[int, int]
    """Width and height, pixels."""
    objects: int | None
    """Upper bound of the number of objects; None without masks."""
    posed: bool
    """Whether the poses of the cameras are known."""


@dataclass(frozen=True, eq=False)
class Model:
    """Geometry of an object in its own frame."""

    size: Float64[np.ndarray, "3"]
    """Extents along its axes, metres."""
    box: OrientedBox
    """Box of least volume."""
    symmetry: str
    """Name of its rotation group, see `datagen.shapes.symmetry`."""


@dataclass(frozen=True, eq=False)
class Images:
    """Images of a recording that belong to one scene."""

    rgb: UInt8[np.ndarray, "image view height width 3"]
    """sRGB."""
    depth: Float32[np.ndarray, "image view height width"]
    """Planar z in metres, 0 = missing."""
    k: Float64[np.ndarray, "image view 3 3"]
    """Camera matrices in pixels, pixel centres at +0.5."""
    world_from_camera: Float64[np.ndarray, "image view 4 4"] | None
    """Poses, OpenCV axes, metres; None if unknown."""
    ids: Int64[np.ndarray, "image view height width"] | None = None
    """Objects by any positive numbers that are constant over the recording; 0 = background; None without masks."""
    categories: Mapping[int, str] | None = None
    """Name of each object by its id; None if unknown."""
    camera_from_object: Float64[np.ndarray, "image view object 4 4"] | None = None
    """Poses of the objects with ids 1, 2 and so on, metres; None if unknown."""
    models: Sequence[Model] | None = None
    """Models of these objects; None if unknown."""


@dataclass(frozen=True)
class Recording:
    """Images that belong together, read on demand."""

    name: str
    """Place of its files, for messages."""
    split: str | None
    """Published split; None if the format has none."""
    survey: Callable[[], Facts]
    """Read its size without its images; raises DatagenError for missing, unfit or damaged files."""
    read: Callable[[Sequence[int]], Images]
    """Read the images of these numbers; raises DatagenError for damaged files."""
    fps: float | None = None
    """Frames per second; None if unknown."""


@dataclass(frozen=True, eq=False)
class Found:
    """Recordings in a folder."""

    recordings: Sequence[Recording]
    grouping: Grouping
    """Grouping of its images if the user does not say."""
    notes: tuple[str, ...] = ()
    """Facts that the user should know, such as scenes that were left out."""


class Importer(Protocol):
    """Reader of one format."""

    def __call__(self, source: Path, options: ReadOptions) -> Found:
        """Find the recordings in a folder.

        Raises:
            UsageError: the folder does not have the layout of the format; says what is missing.
            CorruptFile: a file is damaged.
        """
        ...
