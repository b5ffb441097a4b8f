"""One shard: a file of consecutive scenes of a split, assembled in memory, written in one go and never changed.

Pixel arrays are stored one frame a chunk, so that any frame can be read alone; they are compressed where they are made
(`pack`), and the writer only puts the pieces together. Everything else is one chunk a shard.
"""

import itertools
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.schema import DEPTH_SCALE, EDITS, FIELDS, FORMAT_VERSION, GENERATOR, SceneRecord, scene_hash

CONVENTIONS = (
    "Metres, seconds, kilograms, radians. World: right-handed, z up. Camera: OpenCV (x right, y down, z forward); "
    "pixel (0, 0) is the top left one, its centre at (0.5, 0.5). depth is planar z, stored times depth_scale, 0 = no "
    "return. segmentation: 0 = table and backdrop, else row in objects/ plus 1, constant over frames and views. Poses "
    "a_from_b are 4x4 matrices that take points of frame b to frame a; quaternions are (w, x, y, z)."
)

_HINTS = {"pixels": " Render it first.", **{kind: f" Make them with --edits {kind}." for kind in EDITS}}
"""What to do where a field of a group is not there."""

_PIXEL_AXES = ("frame", "view", "height", "width")
_GZIP_LEVEL = 4
"""Frames take 12 % less than at level 1, are read as fast, and cost 0.1 ms more to write."""


@dataclass(frozen=True, eq=False)
class Frames:
    """A pixel array of one scene as its compressed chunks, one for each frame and view in C order."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    chunks: tuple[bytes, ...]


@dataclass(frozen=True, eq=False)
class PackedScene:
    """One scene, ready to be put into a shard."""

    arrays: dict[str, np.ndarray]
    frames: dict[str, Frames]
    hash: str

    @property
    def fields(self) -> list[str]:
        """Names of the arrays that the hash covers."""
        return sorted([*self.arrays, *self.frames])


def is_pixel_field(name: str) -> bool:
    """Whether the field holds images and is stored one frame a chunk."""
    return FIELDS[name].axes[:4] == _PIXEL_AXES


def pack(record: SceneRecord) -> PackedScene:
    """Hash a record and compress its pixel arrays."""
    return PackedScene(
        {name: np.asarray(array) for name, array in record.items() if not is_pixel_field(name)},
        {name: _compress(array) for name, array in record.items() if is_pixel_field(name)},
        scene_hash(record),
    )


def _compress(array: np.ndarray) -> Frames:
    frame_shape = array.shape[2:]
    frames = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(-1, *frame_shape)
    return Frames(frames.dtype, array.shape, tuple(_deflate(frame) for frame in frames))


def _deflate(frame: np.ndarray) -> bytes:
    """What HDF5's filters shuffle and gzip make of a chunk."""
    shuffled = frame.view(np.uint8).reshape(-1, frame.itemsize).T if frame.itemsize > 1 else frame
    return zlib.compress(shuffled.tobytes(), _GZIP_LEVEL)


def shard_image(scenes: Sequence[PackedScene], attributes: Mapping[str, Any]) -> bytes:
    """The bytes of a shard that holds these scenes; equal input gives equal bytes.

    Args:
        scenes: Consecutive scenes of a split with equal fields.
        attributes: Facts about the shard that go to the file's root.
    """
    with h5py.File("shard.h5", "w", driver="core", backing_store=False, libver=("v110", "v110")) as file:
        constant = {"format_version": FORMAT_VERSION, "generator": GENERATOR, "depth_scale": DEPTH_SCALE}
        for key, value in {**constant, "conventions": CONVENTIONS, **attributes}.items():
            file.attrs[key] = value
        for name in scenes[0].fields:
            if is_pixel_field(name):
                dataset = _write_frames(file, name, [scene.frames[name] for scene in scenes])
            else:
                dataset = _write_array(file, name, np.stack([scene.arrays[name] for scene in scenes]))
            field = FIELDS[name]
            facts = {"unit": field.unit, "frame": field.frame, "description": field.description}
            for key, value in {**facts, "axes": " ".join(("scene", *field.axes))}.items():
                dataset.attrs[key] = value
        hashes = file.create_dataset("hash", data=np.array([scene.hash for scene in scenes], "S64"))
        hashes.attrs["fields"] = " ".join(scenes[0].fields)
        hashes.attrs["description"] = "SHA-256 over the scene's arrays that `fields` names, see schema.scene_hash"
        file.flush()
        return file.id.get_file_image()


def _write_array(file: h5py.File, name: str, stack: np.ndarray) -> h5py.Dataset:
    return file.create_dataset(
        name, data=stack, chunks=stack.shape, shuffle=True, compression="gzip", compression_opts=_GZIP_LEVEL
    )


def _write_frames(file: h5py.File, name: str, scenes: Sequence[Frames]) -> h5py.Dataset:
    shape = scenes[0].shape
    dataset = file.create_dataset(
        name,
        shape=(len(scenes), *shape),
        dtype=scenes[0].dtype,
        chunks=(1, 1, 1, *shape[2:]),
        shuffle=True,
        compression="gzip",
        compression_opts=_GZIP_LEVEL,
    )
    for row, scene in enumerate(scenes):
        for offset, chunk in zip(_chunk_offsets(row, shape), scene.chunks, strict=True):
            dataset.id.write_direct_chunk(offset, chunk)
    return dataset


def _chunk_offsets(row: int, shape: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    zeros = (0,) * (len(shape) - 2)
    return ((row, frame, view, *zeros) for frame, view in itertools.product(range(shape[0]), range(shape[1])))


class Shard:
    """A shard opened for reading.

    Raises:
        DatagenError: the file is not there.
        UsageError: it is an HDF5 file, but not a shard of this format.
        CorruptFile: it cannot be opened, or what is read from it is damaged.
    """

    def __init__(self, path: Path):
        self.path = path
        try:
            self._file = h5py.File(path, "r")
        except FileNotFoundError:
            message = (
                f"{path} is missing: the dataset is incomplete. Run the command that began it again to complete it."
            )
            raise DatagenError(message) from None
        except PermissionError:
            raise
        except OSError as error:
            raise _damaged(path, error) from None
        version = self._file.attrs.get("format_version")
        if self._file.attrs.get("generator") != GENERATOR or "hash" not in self._file:
            raise UsageError(f"{path} is an HDF5 file, but not one of {GENERATOR}; give a dataset made by {GENERATOR}.")
        if version != FORMAT_VERSION:
            raise UsageError(f"{path} has format version {version}, this program reads {FORMAT_VERSION}; update it.")
        self.attributes = dict(self._file.attrs)
        if "settings_hash" not in self.attributes or "fields" not in self._file["hash"].attrs:
            raise _damaged(path, "settings_hash or the list of fields is missing")
        self.fields = str(self._file["hash"].attrs["fields"]).split()
        self._datasets: dict[str, h5py.Dataset] = {}

    def __len__(self) -> int:
        return self._dataset("hash").shape[0]

    def close(self) -> None:
        """Give the file back."""
        self._datasets.clear()
        self._file.close()

    def hashes(self) -> list[str]:
        """The stored hash of every scene."""
        return [text.decode() for text in self.column("hash")]

    def read(self, row: int, name: str, frames: slice | None = None) -> np.ndarray:
        """One field of one scene, of all frames or some (for fields that have a frame axis)."""
        dataset = self._dataset(name)
        try:
            if frames is None or "frame" not in FIELDS[name].axes:
                return np.asarray(dataset[row])
            return dataset[row, frames]
        except OSError as error:
            raise _damaged(self.path, error) from None

    def column(self, name: str) -> np.ndarray:
        """One field of all scenes."""
        try:
            return np.asarray(self._dataset(name)[:])
        except OSError as error:
            raise _damaged(self.path, error) from None

    def packed(self, row: int) -> PackedScene:
        """One scene as it is stored, without unpacking its frames."""
        pixels = [name for name in self.fields if is_pixel_field(name)]
        return PackedScene(
            {name: self.read(row, name) for name in self.fields if name not in pixels},
            {name: self._frames(row, name) for name in pixels},
            self.hashes()[row],
        )

    def _frames(self, row: int, name: str) -> Frames:
        dataset = self._dataset(name)
        shape = dataset.shape[1:]
        try:
            chunks = [dataset.id.read_direct_chunk(offset)[1] for offset in _chunk_offsets(row, shape)]
        except OSError as error:
            raise _damaged(self.path, error) from None
        return Frames(dataset.dtype, shape, tuple(chunks))

    def _dataset(self, name: str) -> h5py.Dataset:
        if name not in self._datasets:
            if name not in self._file:
                hint = _HINTS.get(FIELDS[name].group, "") if name in FIELDS else ""
                raise UsageError(f"{self.path} holds no field {name!r}.{hint} It has: {', '.join(self.fields)}.")
            dataset = self._file[name]
            assert isinstance(dataset, h5py.Dataset)
            self._datasets[name] = dataset
        return self._datasets[name]


def _damaged(path: Path, error: OSError | str) -> CorruptFile:
    return CorruptFile(
        f"{path} is truncated, damaged or not an HDF5 file ({error}). Delete it and run the command that made it again."
    )
