"""Open files from outside safely: sizes are checked before anything is read, and nothing refers to another file.

Datasets, predictions, images and settings may come from anybody. All commands open them with the functions of this
module. A damaged or hostile file then ends in one line of explanation, never in a traceback, exhausted memory or the
content of another file.
"""

import functools
import itertools
import json
import math
import os
import re
import stat
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import deflate
import h5py
import numpy as np
from h5py import h5a, h5d, h5f, h5l, h5o, h5p, h5z  # pyright: ignore[reportAttributeAccessIssue]

from datagen.errors import CorruptFile, UsageError

if TYPE_CHECKING:
    from PIL import Image

MOST_TEXT_BYTES = 64 * 2**20
"""Largest CSV or text file."""
MOST_JSON_BYTES = 8 * 2**20
"""Largest JSON file; values in memory take up to a hundred times as much."""
MOST_FILE_BYTES = 64 * 2**30
"""Largest HDF5 file."""
MOST_ARRAY_BYTES = 2**29
"""Largest array that one call reads from HDF5, NPY or NPZ."""
MOST_CHUNK_BYTES = 2**27
"""Largest chunk of an HDF5 dataset, which is unpacked in memory beside the array that is read."""
MOST_IMAGE_PIXELS = 40_000_000
"""Largest image."""
MOST_NESTING = 64
"""Deepest nesting of JSON values."""
MOST_OBJECTS = 10_000
"""Largest number of groups and datasets of an HDF5 file."""

Attribute = TypeVar("Attribute", str, int, float)

_CHUNK_CACHE_BYTES = 2**18
"""Cache of unpacked chunks of each open HDF5 dataset: enough for tables; frames are read once."""
_FILTERS_THAT_KEEP_SIZES = {h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32, h5z.FILTER_DEFLATE}
"""Filters that do not change the size of a chunk, a checksum aside."""
_CHECKSUM_BYTES = 4
LZ4_FILTER = 32004
"""Number of HDF5's LZ4 filter, which the package hdf5plugin has."""
_FOREIGN_FILTERS = 32001
"""HDF5 and h5py have the filters below this number; packages add the others."""
_NUMBERS = {int: "iu", float: "f"}
"""NumPy kinds that may be read as a type."""
_HDF5_ERRORS = (OSError, KeyError, IndexError, ValueError, TypeError, RuntimeError, OverflowError, AttributeError)
"""h5py reports damage as any of these."""
_NPY_ERRORS = (
    OSError, ValueError, EOFError, KeyError, TypeError, SyntaxError, IndexError, OverflowError, RuntimeError,
    NotImplementedError, RecursionError, MemoryError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
_IMAGE_ERRORS = (
    OSError, SyntaxError, ValueError, TypeError, KeyError, IndexError, OverflowError, AttributeError, RuntimeError,
    NotImplementedError, EOFError, MemoryError, struct.error, zlib.error, ZeroDivisionError, AssertionError,
)  # fmt: skip


def check_file(path: Path, most_bytes: int) -> None:
    """Check that a path names a regular file of limited size, without opening it (opening a FIFO would hang).

    Raises:
        FileNotFoundError: there is nothing at this path.
        UsageError: it is a folder, a FIFO, a device or a socket.
        CorruptFile: the file is larger than `most_bytes`.
    """
    status = path.stat()
    if stat.S_ISDIR(status.st_mode):
        raise UsageError(f"{path} is a folder; expected a file.")
    if not stat.S_ISREG(status.st_mode):
        raise UsageError(f"{path} is a pipe, a device or a socket; expected a regular file. Copy its content to one.")
    if status.st_size > most_bytes:
        raise CorruptFile(
            f"{path} has {status.st_size:,} bytes; expected at most {most_bytes:,} for a file of its kind."
        )


def file_version(path: Path) -> tuple[int, ...] | None:
    """Give numbers that change with a file (device, inode, size, time of modification); None if it is not there."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def read_bytes(path: Path, most_bytes: int = MOST_TEXT_BYTES) -> bytes:
    """Read a whole file of limited size; raises as `check_file`, and OSError where it cannot be read."""
    check_file(path, most_bytes)
    return path.read_bytes()


def read_text(path: Path, most_bytes: int = MOST_TEXT_BYTES) -> str:
    """Read a UTF-8 text file of limited size.

    Raises:
        CorruptFile: the file is too large or not UTF-8.
        Others: as `check_file`.
    """
    try:
        return read_bytes(path, most_bytes).decode("utf-8")
    except UnicodeDecodeError as error:
        raise CorruptFile(f"{path} is damaged or no text file: byte {error.start} is not UTF-8.") from None


def read_json(path: Path, *, most_bytes: int = MOST_JSON_BYTES, infinite: bool = False) -> Any:
    """Read a JSON file whose numbers are finite, or `Infinity` if allowed, and whose nesting is limited.

    Raises:
        CorruptFile: the file is too large, not UTF-8, no JSON, too deeply nested, or holds NaN or infinity.
        Others: as `check_file`.
    """
    text = read_text(path, most_bytes)
    try:
        return parse_json(text, infinite=infinite)
    except ValueError as error:
        raise CorruptFile(f"{path} is damaged: {error}.") from None


def parse_json(text: str, *, infinite: bool = False) -> Any:
    """Parse JSON whose numbers are finite, or `Infinity` if allowed, and whose nesting is at most `MOST_NESTING`.

    Raises:
        ValueError: the text is no JSON, is nested too deeply, or holds NaN, infinity or a huge integer.
    """
    too_deep = f"its values are nested more than {MOST_NESTING} deep"
    try:
        value = json.loads(text, parse_constant=_infinity if infinite else _refuse_constant, parse_float=_finite)
    except RecursionError:
        raise ValueError(too_deep) from None
    if _is_deeper(value, MOST_NESTING):
        raise ValueError(too_deep)
    return value


def _refuse_constant(name: str) -> float:
    raise ValueError(f"it holds {name}, expected finite numbers")


def _infinity(name: str) -> float:
    return math.inf if name == "Infinity" else _refuse_constant(name)


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"it holds {digits:.20}, expected finite numbers")
    return value


def _is_deeper(value: Any, most: int) -> bool:
    level = [value]
    for _ in range(most):
        children: list[Any] = []
        for item in level:
            if isinstance(item, dict):
                children.extend(item.values())
            elif isinstance(item, list):
                children.extend(item)
        level = [item for item in children if isinstance(item, dict | list)]
        if not level:
            return False
    return True


@contextmanager
def open_hdf5(path: Path, advice: str = "") -> Iterator[h5py.File]:
    """Open an HDF5 file from outside for reading, as a context in which errors of h5py are reported as damage.

    Files with external storage, external or soft links, virtual datasets or link loops are refused. `advice` says what
    to do about a damaged file.

    Raises:
        FileNotFoundError, PermissionError: the file is not there, or may not be read.
        UsageError: it is no regular file.
        CorruptFile: it is damaged, refers to another file, or has more objects than `MOST_OBJECTS`.
    """
    with reading_hdf5(path, advice):
        file = open_hdf5_file(path, advice)
        try:
            yield file
        finally:
            file.close()


def open_hdf5_file(path: Path, advice: str = "") -> h5py.File:
    """Open an HDF5 file as `open_hdf5`, for callers that keep it open and close it themselves."""
    file = open_hdf5_by_name(path, advice)
    try:
        with reading_hdf5(path, advice):
            _check_objects(file)
    except BaseException:
        file.close()
        raise
    return file


def open_hdf5_by_name(path: Path, advice: str = "") -> h5py.File:
    """Open an HDF5 file that is read with `hdf5_dataset` and `hdf5_attribute` only, which check what they open.

    It takes a small part of the time of `open_hdf5_file`, which looks at everything in the file; raises as `open_hdf5`.
    """
    check_file(path, MOST_FILE_BYTES)
    return open_hdf5_again(path, advice)


def open_hdf5_again(path: Path, advice: str = "") -> h5py.File:
    """Open an HDF5 file that `open_hdf5_by_name` has opened before and that has not changed since."""
    with reading_hdf5(path, advice):
        return h5py.File(h5f.open(os.fsencode(path), h5f.ACC_RDONLY, _file_access()))


@functools.cache
def _file_access() -> h5p.PropFAID:
    """Settings of `h5py.File(path, "r", locking=False, rdcc_nbytes=_CHUNK_CACHE_BYTES)`, made once for all files."""
    access = h5p.create(h5p.FILE_ACCESS)
    access.set_fclose_degree(h5f.CLOSE_STRONG)
    access.set_file_locking(False, ignore_when_disabled=False)
    metadata, slots, _, preemption = access.get_cache()
    access.set_cache(metadata, slots, _CHUNK_CACHE_BYTES, preemption)
    return access


@contextmanager
def reading_hdf5(path: Path, advice: str = "") -> Iterator[None]:
    """Report what h5py raises inside this context as `CorruptFile` that names the file.

    Raises:
        UsageError: the file is already open in this process, with other settings of HDF5.
    """
    try:
        yield
    except (FileNotFoundError, PermissionError):
        raise
    except _HDF5_ERRORS as error:
        # HDF5 opens a file once per process.
        if any(said in str(error) for said in ("file locking flag values don't match", "close degree doesn't match")):
            raise UsageError(
                f"{path} is already open in this process with other settings of HDF5, such as those of h5py.File. "
                "Close it there first."
            ) from None
        raise damaged_hdf5(path, error, advice) from None


def damaged_hdf5(path: Path, reason: object, advice: str = "") -> CorruptFile:
    """Make the error about an HDF5 file that cannot be read."""
    said = " ".join(str(reason).strip("'\"").split())
    return CorruptFile(f"{path} is truncated, damaged or not an HDF5 file ({said:.200}). {advice}".rstrip())


def _check_objects(file: h5py.File) -> None:
    """Walk all links of a file once and refuse everything that is stored elsewhere or can be reached twice."""
    groups: list[h5py.Group] = [file]
    seen = {_address(file)}
    while groups:
        group = groups.pop()
        for name in group:
            link = group.get(name, getlink=True)
            if not isinstance(link, h5py.HardLink):
                raise ValueError(f"{name} in {group.name} is a link to another place; expected the data itself")
            item = group[name]
            if _address(item) in seen:
                raise ValueError(f"{item.name} has two names or holds itself; expected a tree")
            seen.add(_address(item))
            if len(seen) > MOST_OBJECTS:
                raise ValueError(f"it has more than {MOST_OBJECTS} objects")
            if isinstance(item, h5py.Group):
                groups.append(item)
            elif isinstance(item, h5py.Dataset):
                _check_dataset(item)


def _address(item: h5py.HLObject) -> tuple[int, int]:
    info = h5o.get_info(item.id)
    return info.fileno, info.addr


def _check_dataset(dataset: h5py.Dataset) -> None:
    created = dataset.id.get_create_plist()
    if created.get_external_count():
        raise ValueError(f"{dataset.name} keeps its data in another file, {created.get_external(0)[0]!r}")
    layout = created.get_layout()
    if layout == h5d.VIRTUAL:
        raise ValueError(f"{dataset.name} is a virtual dataset, with its data in other files")
    if layout == h5d.CHUNKED and math.prod(created.get_chunk()) * dataset.id.get_type().get_size() > MOST_CHUNK_BYTES:
        raise ValueError(f"{dataset.name} has chunks of {dataset.chunks}, more than {MOST_CHUNK_BYTES:,} bytes")
    numbers = [created.get_filter(place)[0] for place in range(created.get_nfilters())]
    if len(set(numbers)) < len(numbers) or (LZ4_FILTER in numbers and h5z.FILTER_DEFLATE in numbers):
        raise ValueError(f"{dataset.name} is packed twice")
    if foreign := [number for number in numbers if number >= _FOREIGN_FILTERS and number != LZ4_FILTER]:
        raise ValueError(f"{dataset.name} is packed with HDF5 filter {foreign[0]}; expected gzip or lz4")


def load_lz4() -> None:
    """Make HDF5's LZ4 filter available in this process.

    Raises:
        UsageError: hdf5plugin is not installed.
    """
    try:
        import hdf5plugin  # noqa: F401
    except ImportError:
        raise UsageError(
            "Compression lz4 needs hdf5plugin, which is not installed; install it with: pip install 'obpose[lz4]'"
        ) from None


def hdf5_dataset(parent: h5py.Group, name: str, *, ndim: int | None = None, kinds: str = "biufS") -> h5py.Dataset:
    """Give a dataset of an open file or group whose type and number of axes are as expected; nothing is read.

    Its values may have these NumPy kinds; strings of variable length and references are never allowed.

    Raises:
        ValueError: there is no such dataset, it is of another type or number of axes, or its data is elsewhere.
            `open_hdf5` and `reading_hdf5` report this as `CorruptFile`.
    """
    _check_links(parent, name)
    dataset = hdf5_dataset_again(parent, name)
    _check_dataset(dataset)
    if dataset.dtype.kind not in kinds or dataset.dtype.subdtype is not None or dataset.shape is None:
        raise ValueError(f"{name} has type {dataset.dtype}; expected one of the kinds {', '.join(kinds)}")
    if ndim is not None and dataset.ndim != ndim:
        raise ValueError(f"{name} has shape {dataset.shape}; expected {ndim} axes")
    return dataset


def hdf5_dataset_again(parent: h5py.Group, name: str) -> h5py.Dataset:
    """Give a dataset that `hdf5_dataset` has found to be as expected, of a file that has not changed since."""
    # The low-level function takes a third of the time of `parent[name]`, which makes an object for the file as well.
    item = h5o.open(parent.id, name.encode())
    if not isinstance(item, h5d.DatasetID):
        raise ValueError(f"{name} is a group; expected an array")
    return h5py.Dataset(item, readonly=True)


def _check_links(parent: h5py.Group, name: str) -> None:
    """Refuse a name that leads through a link to another place, without following the link."""
    for end in [*(place for place, sign in enumerate(name) if sign == "/"), len(name)]:
        place = name[:end].encode()
        if not parent.id.links.exists(place):
            raise ValueError(f"{name} is missing; expected an array")
        if parent.id.links.get_info(place).type != h5l.TYPE_HARD:
            raise ValueError(f"{name[:end]} is a link to another place; expected the data itself")


def hdf5_attribute(item: h5py.HLObject, name: str, kind: type[Attribute]) -> Attribute:
    """Read an attribute that is one text (`str`) or one number (`int` or `float`).

    Raises:
        ValueError: there is no such attribute, it is an array or of another type, or a number that is not finite.
            `open_hdf5` and `reading_hdf5` report this as `CorruptFile`.
    """
    if not h5a.exists(item.id, name.encode()):
        raise ValueError(f"attribute {name} is missing")
    # The low-level functions take a third of the time of `item.attrs`, most of the time of opening a shard.
    attribute = h5a.open(item.id, name.encode())
    dtype = attribute.dtype
    is_text = h5py.check_string_dtype(dtype) is not None
    if attribute.shape != () or not (is_text if kind is str else dtype.kind in _NUMBERS[kind]):
        raise ValueError(f"attribute {name} is not of type {kind.__name__}")
    array = np.empty((), dtype)
    attribute.read(array)
    stored: Any = array.item()
    try:
        value = kind(stored.decode() if isinstance(stored, bytes) else stored)
        str(value).encode()  # h5py lets bytes through that are no text
    except UnicodeError:
        raise ValueError(f"attribute {name} is not UTF-8") from None
    if not isinstance(value, str) and not math.isfinite(value):
        raise ValueError(f"attribute {name} is {value}")
    return value


def read_hdf5(dataset: h5py.Dataset, selection: Any = (), sound: set[tuple[int, ...]] | None = None) -> np.ndarray:
    """Read a part of a dataset whose size was checked first: an integer, a slice or a tuple over the leading axes.

    `sound` holds the first places of the chunks that were unpacked before and had their size; it grows.

    Raises:
        ValueError: the selected part is larger than `MOST_ARRAY_BYTES`, or its chunks do not unpack to their size.
        OSError: it is damaged. `open_hdf5` and `reading_hdf5` report both as `CorruptFile`.
    """
    picks = selection if isinstance(selection, tuple) else (selection,)
    places = [_places(pick, size) for pick, size in zip(picks, dataset.shape, strict=False)]
    places += [range(size) for size in dataset.shape[len(picks) :]]
    size = math.prod(map(len, places)) * dataset.dtype.itemsize
    if size > MOST_ARRAY_BYTES:
        raise ValueError(f"{dataset.name} is an array of {size:,} bytes, more than {MOST_ARRAY_BYTES:,}")
    if size and dataset.compression == "unknown":
        _check_lz4(dataset, places)
    elif size and dataset.chunks:
        _check_packed(dataset, places, set() if sound is None else sound)
    return np.asarray(dataset[selection])


def _places(pick: int | slice, size: int) -> range:
    """Places along an axis that a selection picks."""
    return range(size)[pick] if isinstance(pick, slice) else range(pick % size, pick % size + 1)


def _check_packed(dataset: h5py.Dataset, places: Sequence[range], sound: set[tuple[int, ...]]) -> None:
    """Refuse chunks that do not unpack to their size.

    HDF5 would unpack all of a longer one before it looks, and read memory behind a shorter one.
    """
    size = math.prod(dataset.chunks or ()) * dataset.dtype.itemsize
    for start in _chunks(dataset, places):
        if start not in sound and not _has_size(dataset, start, size):
            raise ValueError(f"{dataset.name} has a chunk that does not unpack to its {size:,} bytes")
        sound.add(start)


def _has_size(dataset: h5py.Dataset, start: tuple[int, ...], size: int) -> bool:
    """Whether a chunk is absent or unpacks to its size, as far as its filters are known to keep it."""
    stored = dataset.id.get_chunk_info_by_coord(start)
    if not stored.size:
        return True
    if stored.size > size + size // 100 + 1024:
        return False
    created = dataset.id.get_create_plist()
    places = [place for place in range(created.get_nfilters()) if not stored.filter_mask >> place & 1]
    filters, length = {created.get_filter(place)[0] for place in places}, stored.size
    if h5z.FILTER_DEFLATE in filters:
        try:
            # Other filters may add some bytes.
            length = len(deflate.zlib_decompress(dataset.id.read_direct_chunk(start)[1], size + 1024))
        except deflate.DeflateError:
            return False
    return length in (size, size + _CHECKSUM_BYTES) or not filters <= _FILTERS_THAT_KEEP_SIZES


def _check_lz4(dataset: h5py.Dataset, places: Sequence[range]) -> None:
    """Refuse chunks whose lengths do not fit: the filter would trust them."""
    size = math.prod(dataset.chunks or ()) * dataset.dtype.itemsize
    for start in _chunks(dataset, places):
        if packed := dataset.id.get_chunk_info_by_coord(start).size:
            is_huge = packed > 5 * size + 1024  # more than blocks of one byte, each with its length
            skipped, chunk = (0, b"") if is_huge else dataset.id.read_direct_chunk(start)
            if skipped or not _is_lz4(chunk, size):
                raise ValueError(f"{dataset.name} has a chunk that does not unpack to its {size:,} bytes")


def _is_lz4(chunk: bytes, size: int) -> bool:
    """Whether a chunk has the layout of the LZ4 filter: its size, that of a block, then blocks with their lengths."""
    if len(chunk) < 12:
        return False
    total, block = struct.unpack_from(">QI", chunk)
    if total != size or not block:
        return False
    place = 12
    for _ in range(-(-size // block)):
        if place + 4 > len(chunk):
            return False
        place += 4 + int.from_bytes(chunk[place : place + 4], "big")
    return place == len(chunk)


def _chunks(dataset: h5py.Dataset, places: Sequence[range]) -> Iterator[tuple[int, ...]]:
    """First places of the chunks of a selection."""
    sides = zip(places, dataset.chunks or (), strict=True)
    return itertools.product(*(range(axis[0] // side * side, axis[-1] + 1, side) for axis, side in sides))


def npy_shape(path: Path) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an NPY file from its header alone; raises as `read_npy`."""
    check_file(path, MOST_ARRAY_BYTES + 2**16)
    try:
        with path.open("rb") as file:
            return _npy_header(file)
    except _NPY_ERRORS as error:
        raise _damaged_npy(path, error) from None


def read_npy(path: Path, most_bytes: int = MOST_ARRAY_BYTES) -> np.ndarray:
    """Read an NPY file whose size was checked first; pickles are refused.

    Raises:
        FileNotFoundError: there is no such file.
        UsageError: it is no regular file.
        CorruptFile: it is damaged, holds Python objects, or its array is larger than `most_bytes`.
    """
    check_file(path, most_bytes + 2**16)
    try:
        return _parse_npy(path.read_bytes(), most_bytes)
    except _NPY_ERRORS as error:
        raise _damaged_npy(path, error) from None


def read_npz(path: Path, names: Sequence[str], most_bytes: int = MOST_ARRAY_BYTES) -> dict[str, np.ndarray]:
    """Read the present ones of the named arrays of an NPZ file; sizes are checked first, and pickles refused.

    Raises:
        FileNotFoundError: there is no such file.
        UsageError: it is no regular file.
        CorruptFile: it is damaged, holds Python objects, or an array is larger than `most_bytes`.
    """
    check_file(path, 2 * most_bytes)
    with _reading_npz(path) as archive:
        there = [name for name in names if f"{name}.npy" in archive.namelist()]
        return {name: _parse_npy(_member(archive, f"{name}.npy", most_bytes), most_bytes) for name in there}


def npz_headers(path: Path, names: Sequence[str]) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
    """Shape and type of the present ones of the named arrays of an NPZ file, from the headers alone.

    Raises:
        As `read_npz`.
    """
    check_file(path, 2 * MOST_ARRAY_BYTES)
    headers = {}
    with _reading_npz(path) as archive:
        for name in names:
            if f"{name}.npy" in archive.namelist():
                with archive.open(f"{name}.npy") as file:
                    headers[name] = _npy_header(file)
    return headers


@contextmanager
def _reading_npz(path: Path) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except _NPY_ERRORS as error:
        raise CorruptFile(
            f"{path} is damaged or no NPZ file ({brief_reason(error)}). Write it again with numpy.savez."
        ) from None


def _damaged_npy(path: Path, error: Exception) -> CorruptFile:
    return CorruptFile(f"{path} is damaged or no NPY file ({brief_reason(error)}). Write it again with numpy.save.")


def brief_reason(error: Exception) -> str:
    """Shorten an error about a file to one line, without Python's wording for type errors."""
    if isinstance(error, KeyError) and error.args:
        return f"{error.args[0]!s:.160} is missing"
    text = re.sub(r"<[\w.]+ object at 0x[0-9a-f]+>", "a value", " ".join(f"{error}".split()))
    if isinstance(error, AttributeError | TypeError):
        return "a value has another type than expected"
    return text[:200] or type(error).__name__


def _member(archive: zipfile.ZipFile, name: str, most_bytes: int) -> bytes:
    """Unpack at most as many bytes as allowed, whatever the archive says of itself."""
    too_large = f"{name} is larger than {most_bytes:,} bytes"
    if archive.getinfo(name).file_size > most_bytes + 2**16:
        raise ValueError(too_large)
    with archive.open(name) as file:
        data = file.read(most_bytes + 2**16 + 1)
    if len(data) > most_bytes + 2**16:
        raise ValueError(too_large)
    return data


def _parse_npy(data: bytes, most_bytes: int) -> np.ndarray:
    file = BytesIO(data)
    shape, dtype = _npy_header(file)
    size = math.prod(shape) * dtype.itemsize
    if size > most_bytes:
        raise ValueError(f"its array would have {size:,} bytes, more than {most_bytes:,}")
    if dtype.hasobject or dtype.kind not in "biufcSU":
        raise ValueError(f"it holds {dtype}, expected plain numbers")
    if len(data) - file.tell() < size:
        raise ValueError(f"it has {len(data) - file.tell():,} bytes of data, expected {size:,}")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def _npy_header(file: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    if any(side < 0 for side in shape):
        raise ValueError(f"it has shape {shape}")
    return shape, dtype


@contextmanager
def open_image(path: Path, formats: Sequence[str] = ("PNG", "JPEG", "TIFF")) -> Iterator["Image.Image"]:
    """Open an image whose header was checked; its pixels are decoded when they are first used, inside the context.

    Raises:
        FileNotFoundError: there is no such file.
        UsageError: it is no regular file.
        CorruptFile: it is damaged, of another format, or has more pixels than `MOST_IMAGE_PIXELS`.
    """
    check_file(path, 16 * MOST_IMAGE_PIXELS)
    with open_embedded_image(str(path), path, formats) as image:
        yield image


@contextmanager
def open_embedded_image(
    name: str, content: Path | BytesIO, formats: Sequence[str] = ("PNG", "JPEG", "WEBP")
) -> Iterator["Image.Image"]:
    """Open an image as `open_image`; `name` stands for it in messages."""
    from PIL import Image, UnidentifiedImageError

    try:
        # Pillow warns of damaged metadata, and of sizes that are refused below.
        with warnings.catch_warnings(action="ignore"), Image.open(content, formats=list(formats)) as image:
            width, height = image.size
            if width * height > MOST_IMAGE_PIXELS:
                raise CorruptFile(
                    f"{name} has {width} x {height} pixels; expected at most {MOST_IMAGE_PIXELS:,}. Make it smaller."
                )
            yield image
    except UnidentifiedImageError:
        raise CorruptFile(f"{name} is damaged or no image; expected {', '.join(formats)}.") from None
    except Image.DecompressionBombError:
        raise CorruptFile(
            f"{name} has too many pixels; expected at most {MOST_IMAGE_PIXELS:,}. Make it smaller."
        ) from None
    except (FileNotFoundError, PermissionError):
        raise
    except _IMAGE_ERRORS as error:
        raise CorruptFile(f"{name} is damaged or no image ({brief_reason(error)}).") from None


def exr_header(path: Path) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of the depth in an EXR image from its header; raises as `read_exr`."""
    corners = _open_exr(path, header_only=True).header()["dataWindow"]
    width, height = (int(side) for side in corners[1] - corners[0] + 1)
    if not 0 < width * height <= MOST_IMAGE_PIXELS:
        raise CorruptFile(
            f"{path} has {width} x {height} pixels; expected 1 to {MOST_IMAGE_PIXELS:,}. Make it smaller."
        )
    return (height, width), np.dtype(np.float32)


def read_exr(path: Path) -> np.ndarray:
    """Read the depth of an EXR image: channel Z, the only channel, or the first of three equal ones.

    Raises:
        FileNotFoundError: there is no such file.
        UsageError: it is no regular file, or the package `OpenEXR` is missing.
        CorruptFile: it is damaged, too large, or has several channels of which none is called Z.
    """
    exr_header(path)
    try:
        channels = {name: channel.pixels for name, channel in _open_exr(path, header_only=False).channels().items()}
    except (*_NPY_ERRORS, *_IMAGE_ERRORS) as error:
        raise CorruptFile(f"{path} is damaged or no EXR image ({brief_reason(error)}).") from None
    values = channels["Z"] if "Z" in channels else next(iter(channels.values()), None)
    if values is None or not ("Z" in channels or len(channels) == 1) or values.dtype.kind not in "uif":
        raise CorruptFile(f"{path} has the channels {', '.join(channels)}; expected depth in one channel, such as Z.")
    if values.ndim == 3 and not np.array_equal(values, np.broadcast_to(values[..., :1], values.shape), equal_nan=True):
        raise CorruptFile(f"{path} holds colours; expected depth in one channel, such as Z.")
    return (values if values.ndim == 2 else values[..., 0]).astype(np.float32)


def _open_exr(path: Path, *, header_only: bool) -> Any:
    check_file(path, 16 * MOST_IMAGE_PIXELS)
    try:
        import OpenEXR
    except ImportError:
        raise UsageError(
            f"{path}: EXR images need the package OpenEXR; install it with `pip install OpenEXR`."
        ) from None
    try:
        return OpenEXR.File(str(path), header_only=header_only)
    except (*_NPY_ERRORS, *_IMAGE_ERRORS) as error:
        raise CorruptFile(f"{path} is damaged or no EXR image ({brief_reason(error)}).") from None
