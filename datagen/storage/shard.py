"""One shard: a file of consecutive scenes of a split, assembled in memory, written in one go and never changed.

Pixel arrays are stored one frame a chunk, so that any frame can be read alone; they are compressed where they are made
(`pack`), and the writer only puts the pieces together. Everything else is one chunk a shard.
"""

import functools
import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import deflate
import h5py
import numpy as np
from h5py import h5z  # pyright: ignore[reportAttributeAccessIssue]

from datagen.errors import DatagenError, UsageError
from datagen.schema import (
    DEPTH_SCALE,
    EDITS,
    FIELDS,
    FORMAT_VERSION,
    GENERATOR,
    IMPORTER,
    SIGNALS,
    SceneRecord,
    check_field,
    scene_hash,
)
from datagen.storage.safe_io import (
    LZ4_FILTER,
    MOST_ARRAY_BYTES,
    MOST_CHUNK_BYTES,
    file_version,
    hdf5_attribute,
    hdf5_dataset,
    hdf5_dataset_again,
    load_lz4,
    open_hdf5_again,
    open_hdf5_by_name,
    parse_json,
    read_hdf5,
    reading_hdf5,
)
from datagen.storage.spec import (
    Compression,
    Spec,
    compression_of,
    is_imported,
    lengths_of,
    settings_hash,
    shard_name,
    shard_numbers,
)

CONVENTIONS = (
    "Metres, seconds, kilograms, radians. World: right-handed, z up. Camera: OpenCV (x right, y down, z forward); "
    "pixel (0, 0) is the top left one, its centre at (0.5, 0.5). depth is planar z, stored times depth_scale, 0 = no "
    "return. segmentation: 0 = table and backdrop, else row in objects/ plus 1, constant over frames and views. Poses "
    "a_from_b are 4x4 matrices that take points of frame b to frame a; quaternions are (w, x, y, z)."
)

_HINTS = {
    "pixels": " Render it first.",
    **{kind: f" Make them with --edits {kind}." for kind in EDITS},
    **{name: f" Make it with --with {name}, for example with `render --from`." for name in SIGNALS},
}
"""Advice for a missing field, by the field's group."""

_ADVICE = "Delete it and run the command that made it again."
"""Advice for a damaged shard."""
_HASH_LENGTH = 64
"""Length of a SHA-256 in hexadecimal digits."""
_MOST_LETTERS = 2**20
"""Greatest length of a stored text, letters."""
_TEXT = bytes([0, *range(32, 127)])
"""Bytes allowed in stored text and its padding."""
_PIXEL_AXES = ("frame", "view", "height", "width")
_GZIP_LEVEL = 4
"""Compression level of tables."""
_DEFLATE_LEVEL = 5
"""Compression level of frames, by libdeflate. They take 7 % less space than by zlib at level 4, and 27 % less time."""
_FILTERS: dict[Compression, dict[str, Any]] = {
    "gzip": {"compression": "gzip", "compression_opts": _GZIP_LEVEL},
    "lz4": {"compression": LZ4_FILTER, "compression_opts": (0,)},
}
"""Options of `create_dataset`; only images can have lz4."""


@dataclass(frozen=True, eq=False)
class Frames:
    """A pixel array of one scene as its compressed chunks, one for each frame and view in C order."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    chunks: tuple[bytes, ...]
    compression: Compression = "gzip"


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
    """Whether the field holds images, which are stored with one chunk per frame and view."""
    return name in FIELDS and FIELDS[name].axes[:4] == _PIXEL_AXES


def pack(record: SceneRecord, compression: Compression = "gzip") -> PackedScene:
    """Hash a record and compress its pixel arrays.

    Raises:
        UsageError: the compression is not installed.
    """
    return PackedScene(
        {name: np.asarray(array) for name, array in record.items() if not is_pixel_field(name)},
        {name: _compress(array, compression) for name, array in record.items() if is_pixel_field(name)},
        scene_hash(record),
    )


def _compress(array: np.ndarray, compression: Compression) -> Frames:
    frame_shape = array.shape[2:]
    frames = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).reshape(-1, *frame_shape)
    chunks = _lz4(frames) if compression == "lz4" else tuple(_deflate(frame) for frame in frames)
    return Frames(frames.dtype, array.shape, chunks, compression)


def _lz4(frames: np.ndarray) -> tuple[bytes, ...]:
    """Compress frames as chunks with HDF5's shuffle and LZ4 filters, by a file in memory."""
    load_lz4()
    with h5py.File("frames.h5", "w", driver="core", backing_store=False) as file:
        chunk = (1, *frames.shape[1:])
        dataset = file.create_dataset("frames", data=frames, chunks=chunk, shuffle=True, **_FILTERS["lz4"])
        file.flush()
        zeros = (0,) * (frames.ndim - 1)
        return tuple(dataset.id.read_direct_chunk((frame, *zeros))[1] for frame in range(len(frames)))


def _deflate(frame: np.ndarray) -> bytes:
    """Compress a chunk as HDF5's shuffle and gzip filters do."""
    shuffled = frame.view(np.uint8).reshape(-1, frame.itemsize).T if frame.itemsize > 1 else frame
    return bytes(deflate.zlib_compress(shuffled.tobytes(), _DEFLATE_LEVEL))


def _inflate(chunk: bytes, frame: np.ndarray) -> None:
    """Unpack a chunk into a contiguous frame: the inverse of `_deflate`.

    Raises:
        deflate.DeflateError: the chunk is damaged, or has another size.
    """
    unpacked = np.frombuffer(deflate.zlib_decompress(chunk, frame.nbytes), np.uint8)
    if len(unpacked) != frame.nbytes:
        raise deflate.DeflateError(f"{len(unpacked)} bytes, expected {frame.nbytes}")
    frame.reshape(-1).view(np.uint8).reshape(-1, frame.itemsize)[:] = unpacked.reshape(frame.itemsize, -1).T


def shard_image(scenes: Sequence[PackedScene], attributes: Mapping[str, Any]) -> bytes:
    """Bytes of a shard file of consecutive scenes with equal fields, described by attributes of the file's root group.

    Equal input gives equal bytes.

    Raises:
        DatagenError: scenes have arrays of different shapes.
    """
    with h5py.File("shard.h5", "w", driver="core", backing_store=False, libver=("v110", "v110")) as file:
        constant = {"format_version": FORMAT_VERSION, "generator": GENERATOR, "depth_scale": DEPTH_SCALE}
        for key, value in {**constant, "conventions": CONVENTIONS, **attributes}.items():
            file.attrs[key] = value
        for name in scenes[0].fields:
            if is_pixel_field(name):
                frames = [scene.frames[name] for scene in scenes]
                _check_shapes(name, frames)
                dataset = _write_frames(file, name, frames)
            else:
                arrays = [scene.arrays[name] for scene in scenes]
                _check_shapes(name, arrays)
                dataset = _write_array(file, name, np.stack(arrays))
            field = FIELDS[name]
            facts = {"unit": field.unit, "frame": field.frame, "description": field.description}
            for key, value in {**facts, "axes": " ".join(("scene", *field.axes))}.items():
                dataset.attrs[key] = value
        hashes = file.create_dataset("hash", data=np.array([scene.hash for scene in scenes], "S64"))
        hashes.attrs["fields"] = " ".join(scenes[0].fields)
        hashes.attrs["description"] = "SHA-256 over the scene's arrays that `fields` names, see schema.scene_hash"
        file.flush()
        return file.id.get_file_image()


def _check_shapes(name: str, arrays: Sequence[np.ndarray | Frames]) -> None:
    shape = arrays[0].shape
    if others := [array.shape for array in arrays if array.shape != shape]:
        raise DatagenError(
            f"{name} has shapes {shape} and {others[0]} in scenes of one shard; expected equal ones. If an older "
            "program made some of them, delete the shard and run the command again."
        )


def _write_array(
    file: h5py.File, name: str, stack: np.ndarray, most_chunk_bytes: int = MOST_CHUNK_BYTES
) -> h5py.Dataset:
    chunks = _table_chunk(stack, most_chunk_bytes)
    return file.create_dataset(name, data=stack, chunks=chunks, shuffle=True, **_FILTERS["gzip"])


def _table_chunk(stack: np.ndarray, most_bytes: int) -> tuple[int, ...]:
    """All scenes, or as many of them, or of one scene's frames, as a chunk may hold."""
    room = most_bytes // stack.itemsize
    scenes = room // max(1, math.prod(stack.shape[1:]))
    if scenes or stack.ndim == 1:
        return min(len(stack), max(1, scenes)), *stack.shape[1:]
    return 1, min(stack.shape[1], max(1, room // math.prod(stack.shape[2:]))), *stack.shape[2:]


def _write_frames(file: h5py.File, name: str, scenes: Sequence[Frames]) -> h5py.Dataset:
    shape = scenes[0].shape
    dataset = file.create_dataset(
        name,
        shape=(len(scenes), *shape),
        dtype=scenes[0].dtype,
        chunks=(1, 1, 1, *shape[2:]),
        shuffle=True,
        **_FILTERS[scenes[0].compression],
    )
    for row, scene in enumerate(scenes):
        for offset, chunk in zip(_chunk_offsets(row, shape), scene.chunks, strict=True):
            dataset.id.write_direct_chunk(offset, chunk)
    return dataset


def _chunk_offsets(row: int, shape: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    zeros = (0,) * (len(shape) - 2)
    return ((row, frame, view, *zeros) for frame, view in itertools.product(range(shape[0]), range(shape[1])))


@dataclass(frozen=True, slots=True)
class Checked:
    """Checks that a shard has passed, which need no repetition while its file stays the same."""

    version: tuple[int, ...] | None
    """The file's `file_version`."""
    scenes: int
    fields: tuple[str, ...]
    """Names of all arrays."""
    arrays: frozenset[str]
    """Names of those whose type and shape were checked."""


_shared = functools.lru_cache(maxsize=64)(lambda names: names)
"""Give one object for equal names, so that a million shards do not hold as many copies."""


class Shard:
    """A shard of a dataset, opened for reading; its attributes are compared with the dataset's spec.

    Arrays are checked when they are first used, so that opening is cheap; `check` checks all of them.

    Raises:
        DatagenError: the file is not there.
        UsageError: it is no shard, of another format version, or holds scenes of another dataset or place; or its
            compression is not installed.
        CorruptFile: it is damaged.
    """

    def __init__(
        self,
        folder: Path,
        spec: Spec,
        split: str,
        number: int,
        *,
        settings: str | None = None,
        checked: "Checked | None" = None,
        most_bytes: int = MOST_ARRAY_BYTES,
    ):
        """Open the file; `settings` is the spec's `settings_hash` if known, `checked` that of an earlier opening.

        Images of more than `most_bytes`, stored or unpacked, are left to HDF5.
        """
        self.path = folder / shard_name(split, number)
        self._most_bytes = most_bytes
        self._datasets: dict[str, h5py.Dataset] = {}
        self._deflated: dict[str, bool] = {}
        self._sound: defaultdict[str, set[tuple[int, ...]]] = defaultdict(set)
        self._lengths = lengths_of(spec)
        self._compression: Compression = compression_of(spec)
        if self._compression == "lz4":
            load_lz4()
        self._imported = is_imported(spec)
        self._version = file_version(self.path)
        if checked and checked.version == self._version:
            self._file = open_hdf5_again(self.path, _ADVICE)
            self._scenes, self.fields, self._checked = checked.scenes, list(checked.fields), set(checked.arrays)
            return
        self._file, self._checked = _open(self.path), set[str]()
        try:
            with reading_hdf5(self.path, _ADVICE):
                self._check_identity(spec, split, number, settings or settings_hash(spec))
                hashes = self._scene_hashes(spec)
                self._scenes, self.fields = len(hashes), hdf5_attribute(hashes, "fields", str).split()
        except BaseException:
            self.close()
            raise

    def __len__(self) -> int:
        return self._scenes

    @property
    def checked(self) -> "Checked":
        """Checks that the file has passed."""
        return Checked(self._version, self._scenes, _shared(tuple(self.fields)), _shared(frozenset(self._checked)))

    def close(self) -> None:
        """Close the file."""
        self._datasets.clear()
        # The last reference closes it. `h5py.File.close` would look through the objects of all open files.
        del self._file

    def check(self) -> None:
        """Check type and shape of every array without reading it.

        Raises:
            CorruptFile: an array is missing, or is of another type or shape than the format's.
        """
        for name in self.fields:
            self._dataset(name)

    def hashes(self) -> list[str]:
        """The stored hash of every scene."""
        return [text.decode() for text in self.column("hash")]

    def read(self, row: int, name: str, frames: slice | None = None) -> np.ndarray:
        """One field of one scene, of all frames or some (for fields that have a frame axis)."""
        dataset = self._dataset(name)
        if is_pixel_field(name) and (array := self._read_deflated(row, name, frames)) is not None:
            return array
        place = (row,)
        if frames is not None and name in FIELDS and "frame" in FIELDS[name].axes:
            place = row, *(slice(None),) * FIELDS[name].axes.index("frame"), frames
        with reading_hdf5(self.path, _ADVICE):
            array = read_hdf5(dataset, place if len(place) > 1 else row, self._sound[name])
            self._check_values(array, name)
        return array

    def _read_deflated(self, row: int, name: str, frames: slice | None) -> np.ndarray | None:
        """Images of one scene by libdeflate, which unpacks faster than HDF5; None where only HDF5 knows what to do."""
        dataset = self._datasets[name]
        if name not in self._deflated:
            with reading_hdf5(self.path, _ADVICE):
                is_small = dataset.id.get_storage_size() <= self._most_bytes  # and each chunk with it
                self._deflated[name] = is_small and self._compression == "gzip" and _is_packed_as_here(dataset, "gzip")
        count, views, *frame_shape = dataset.shape[1:]
        chosen = range(count)[frames or slice(None)]
        size = len(chosen) * views * math.prod(frame_shape) * dataset.dtype.itemsize
        if not self._deflated[name] or size > self._most_bytes:
            return None
        array = np.empty((len(chosen), views, *frame_shape), dataset.dtype)
        zeros = (0,) * len(frame_shape)
        try:
            for place, view in np.ndindex(len(chosen), views):
                skipped_filters, chunk = dataset.id.read_direct_chunk((row, chosen[place], view, *zeros))
                if skipped_filters:
                    return None
                _inflate(chunk, array[place, view])
        except (OSError, RuntimeError, ValueError, deflate.DeflateError):
            return None
        return array

    def column(self, name: str) -> np.ndarray:
        """One field of all scenes."""
        dataset = self._dataset(name)
        with reading_hdf5(self.path, _ADVICE):
            array = read_hdf5(dataset, sound=self._sound[name])
            self._check_values(array, name)
        return array

    def rejections(self, row: int) -> Counter[str]:
        """Number of rejected samples of a scene, by reason."""
        text = self.read(row, "scene/rejections").item().decode()
        with reading_hdf5(self.path, _ADVICE):
            counts = parse_json(text or "{}")
            if type(counts) is not dict or not all(type(count) is int and count >= 0 for count in counts.values()):
                raise ValueError(f"scene/rejections holds {text:.40}, expected counts by their reasons")
        return Counter(counts)

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
        if not _is_packed_as_here(dataset, self._compression):
            return _compress(self.read(row, name), self._compression)
        shape = dataset.shape[1:]
        with reading_hdf5(self.path, _ADVICE):
            stored = [dataset.id.read_direct_chunk(offset) for offset in _chunk_offsets(row, shape)]
            if any(skipped_filters for skipped_filters, _ in stored):
                return _compress(self.read(row, name), self._compression)
        return Frames(dataset.dtype, shape, tuple(chunk for _, chunk in stored), self._compression)

    def _dataset(self, name: str) -> h5py.Dataset:
        if name not in self._datasets:
            if name not in self.fields:
                hint = _HINTS.get(FIELDS[name].group, "") if name in FIELDS else ""
                hint = " It was imported, and its source does not have it." if self._imported else hint
                raise UsageError(f"{self.path} holds no field {name!r}.{hint} It has: {', '.join(self.fields):.500}.")
            with reading_hdf5(self.path, _ADVICE):
                if name in self._checked:
                    dataset = hdf5_dataset_again(self._file, name)
                else:
                    dataset = hdf5_dataset(self._file, name)
                    self._check_array(dataset, name)
            self._datasets[name] = dataset
            self._checked.add(name)
        return self._datasets[name]

    def _check_array(self, dataset: h5py.Dataset, name: str) -> None:
        if dataset.shape[:1] != (len(self),):
            raise ValueError(f"{name} has shape {dataset.shape}, expected {len(self)} scenes")
        if dataset.chunks and math.prod(dataset.chunks) > math.prod(dataset.shape):
            raise ValueError(f"{name} has chunks of shape {dataset.chunks}, larger than its shape {dataset.shape}")
        if dataset.dtype.kind == "S" and dataset.dtype.itemsize > _MOST_LETTERS:
            raise ValueError(f"{name} has texts of {dataset.dtype.itemsize} letters, expected at most {_MOST_LETTERS}")
        if name in FIELDS:
            check_field(FIELDS[name], dataset.dtype, dataset.shape[1:], self._lengths)

    def _check_values(self, array: np.ndarray, name: str) -> None:
        """Check that texts are ASCII, and that there are no more objects than rows."""
        if array.dtype.kind == "S" and array.tobytes().translate(None, _TEXT):
            raise ValueError(f"{name} holds text with bytes that are not printable ASCII")
        if name == "objects/count" and np.max(array) > (rows := self._object_rows()):
            raise ValueError(f"objects/count is {np.max(array)}, expected at most {rows}")

    def _object_rows(self) -> int:
        """Length of the object axis, by the first array that has one."""
        name = next((name for name in FIELDS if name in self.fields and "object" in FIELDS[name].axes), None)
        if name is None:
            raise ValueError("objects/count is there without any array of objects")
        return self._dataset(name).shape[1 + FIELDS[name].axes.index("object")]

    def _scene_hashes(self, spec: Spec) -> h5py.Dataset:
        dataset = hdf5_dataset(self._file, "hash", ndim=1, kinds="S")
        most = spec["scenes_per_shard"]
        if dataset.dtype.itemsize != _HASH_LENGTH or not 1 <= len(dataset) <= most:
            raise ValueError(
                f"hash has {len(dataset)} values of type {dataset.dtype}, expected 1 to {most} of type S64"
            )
        self._datasets["hash"] = dataset
        return dataset

    def _check_identity(self, spec: Spec, split: str, number: int, settings: str) -> None:
        if hdf5_attribute(self._file, "settings_hash", str) != settings:
            raise UsageError(
                f"{self.path} belongs to another dataset, which was made with other settings. "
                "Move it away and run the command that made the dataset again."
            )
        self._check_place(spec, split, number)
        for name, value in (("data_version", spec["data_version"]), ("depth_scale", DEPTH_SCALE)):
            stored = hdf5_attribute(self._file, name, type(value))
            if stored != value:
                raise ValueError(f"attribute {name} is {stored}, expected {value}")

    def _check_place(self, spec: Spec, split: str, number: int) -> None:
        place = hdf5_attribute(self._file, "split", str), hdf5_attribute(self._file, "first_scene", int)
        expected = split, number * spec["scenes_per_shard"]
        if place != expected:
            raise UsageError(
                f"{self.path} holds scenes of {place[0]} from scene {place[1]} on; expected {split} from scene "
                f"{expected[1]} on. It was copied, renamed or swapped. Move it away and run the command that made the "
                "dataset again."
            )


def scenes_present(folder: Path, spec: Spec, split: str, first: int = 0) -> int:
    """Number of scenes of a split up to the last present one, in shards from number `first` on; 0 if there is none.

    Every one of these shards is checked; raises as `Shard` and `Shard.check`.
    """
    scenes = 0
    for number in shard_numbers(folder, split):
        if number >= first:
            with closing(Shard(folder, spec, split, number)) as shard:
                shard.check()
                scenes = number * spec["scenes_per_shard"] + len(shard)
    return scenes


def shard_settings(path: Path) -> str | None:
    """Settings hash of the dataset that a shard belongs to, None if the file is not a shard or cannot be read."""
    try:
        file = _open(path)
    except (DatagenError, OSError):
        return None
    with closing(file), suppress(DatagenError), reading_hdf5(path):
        return hdf5_attribute(file, "settings_hash", str)
    return None


def _open(path: Path) -> h5py.File:
    """Open a shard of this format version."""
    try:
        file = open_hdf5_by_name(path, _ADVICE)
    except FileNotFoundError:
        raise DatagenError(
            f"{path} is missing: the dataset is incomplete. Run the command that began it again to complete it."
        ) from None
    try:
        with reading_hdf5(path, _ADVICE):
            _check_format(file, path)
    except BaseException:
        file.close()
        raise
    return file


def _check_format(file: h5py.File, path: Path) -> None:
    if "generator" not in file.attrs or hdf5_attribute(file, "generator", str) not in (GENERATOR, IMPORTER):
        raise UsageError(f"{path} is an HDF5 file, but not one of {GENERATOR}; give a dataset made by {GENERATOR}.")
    version = hdf5_attribute(file, "format_version", int)
    if version != FORMAT_VERSION:
        raise UsageError(f"{path} has format version {version}, this program reads {FORMAT_VERSION}; update it.")


def _is_packed_as_here(dataset: h5py.Dataset, compression: Compression) -> bool:
    """Whether chunks can be taken over as they are; other programs may have repacked the file."""
    filters = dataset.id.get_create_plist()
    stock = [filters.get_filter(place)[0] for place in range(filters.get_nfilters())]
    last = LZ4_FILTER if compression == "lz4" else h5z.FILTER_DEFLATE
    return dataset.chunks == (1, 1, 1, *dataset.shape[3:]) and stock == [h5z.FILTER_SHUFFLE, last]
