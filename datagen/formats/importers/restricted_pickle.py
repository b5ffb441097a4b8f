"""NPY files that hold pickled Python objects, read without running any code of the file.

A pickle is a program: it may name any function and call it. Here it can only build dicts, lists, tuples, strings,
numbers and NumPy arrays of plain numbers. The functions with which NumPy pickles arrays are replaced by those below,
which only collect their arguments. The arrays are then made from checked shapes, types and bytes.
"""

import math
import pickle
import re
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from datagen.errors import CorruptFile
from datagen.storage.safe_io import brief_reason, read_bytes

MOST_BYTES = 2**28
"""Largest file, and largest array in it."""
_MOST_DEPTH = 32
_MOST_VALUES = 200_000
_DTYPE = re.compile(r"[<>|=]?([biufSU][0-9]{1,9}|O[0-9]{0,2}|\?)")
_PLAIN = (bool, int, float, str, bytes, type(None))
_ADVICE = "Only dicts, lists, strings, numbers and NumPy arrays are read; write it again with numpy.save."


def read_pickled_npy(path: Path) -> Any:
    """Read an NPY file of objects: dicts, lists and arrays as they were saved; arrays of objects become lists.

    A single object, which NumPy saves as an array without axes, is given as it is.

    Raises:
        FileNotFoundError: there is no such file.
        CorruptFile: it is damaged, or holds anything but plain values; nothing of it was run.
    """
    data = read_bytes(path, MOST_BYTES)
    try:
        return _parse(data)
    except RecursionError:
        raise CorruptFile(f"{path} is refused: its values are nested too deeply. {_ADVICE}") from None
    except MemoryError:
        raise CorruptFile(f"{path} is refused: it needs too much memory. {_ADVICE}") from None
    except Exception as error:  # any opcode may fail in its own way on a damaged file
        raise CorruptFile(f"{path} is refused: {brief_reason(error)}. {_ADVICE}") from None


def _parse(data: bytes) -> Any:
    file = BytesIO(data)
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read_header(file)
    if not dtype.hasobject:
        return _array(shape, dtype.str, fortran, data[file.tell() :])
    if dtype.kind != "O":
        raise ValueError(f"it holds {dtype}, expected objects")
    value = _Restricted(file, encoding="latin1").load()
    return _plain(_without_axes(value), [0], 0)


def _without_axes(value: Any) -> Any:
    """Content of an array of objects that has no axes."""
    content = value.content if isinstance(value, _Array) else None
    return content[0] if isinstance(content, list) and value.shape == () else value


class _Array:
    """Array under construction: collects what NumPy's pickles say about it."""

    def __init__(self, *arguments: Any):
        self.shape: tuple[int, ...] = ()
        self.content: np.ndarray | list[Any] | None = None

    def __setstate__(self, state: Any) -> None:
        _, shape, dtype, fortran, data = state
        self.shape = _checked_shape(shape)
        if not isinstance(dtype, _Dtype):
            raise ValueError(f"an array has the type {type(dtype).__name__}")
        if dtype.is_object:
            if type(data) is not list or len(data) != math.prod(self.shape):
                raise ValueError("an array of objects does not have as many as its shape says")
            if len(self.shape) > 1:
                raise ValueError("it has an array of objects with several axes, expected one")
            self.content = data
        else:
            data = data.encode("latin1") if type(data) is str else data  # written by Python 2
            self.content = _array(shape, dtype.name, bool(fortran), data)


class _Dtype:
    """Type of an array: a checked name, to which its pickle may add the byte order."""

    def __init__(self, name: Any, *flags: Any):
        name = name.decode("ascii") if type(name) is bytes else name
        if type(name) is not str or not _DTYPE.fullmatch(name):
            raise ValueError(f"an array holds {name!r:.40}, expected plain numbers or texts")
        self.name: str = name

    @property
    def is_object(self) -> bool:
        return "O" in self.name

    def __setstate__(self, state: Any) -> None:
        order = state[1].decode("ascii") if type(state[1]) is bytes else state[1]
        if state[2] is not None or state[3] is not None or state[4] is not None or order not in ("<", ">", "|", "="):
            raise ValueError("an array has a structured type, expected plain numbers or texts")
        self.name = order.replace("=", "<") + self.name.lstrip("<>|=")


def _scalar(dtype: Any, data: Any) -> Any:
    """A number of NumPy's own types."""
    if not isinstance(dtype, _Dtype) or dtype.is_object:
        raise ValueError("a number has no plain type")
    return _array((), dtype.name, False, data.encode("latin1") if type(data) is str else data)[()].item()


def _from_buffer(data: Any, dtype: Any, shape: Any, order: Any) -> _Array:
    """An array as pickle protocol 5 stores it."""
    if not isinstance(dtype, _Dtype) or dtype.is_object or order not in ("C", "F"):
        raise ValueError("an array has no plain type")
    made = _Array()
    made.shape = _checked_shape(shape)
    made.content = _array(shape, dtype.name, order == "F", bytes(data) if type(data) is bytearray else data)
    return made


def _encode(text: Any, encoding: Any) -> bytes:
    """Bytes as pickle protocols before 3 store them."""
    if type(text) is not str or encoding != "latin1":
        raise ValueError("bytes are stored as something else than text in latin1")
    return text.encode("latin1")


def _array(shape: Any, name: str, fortran: bool, data: Any) -> np.ndarray:
    """An array of its own from checked parts."""
    shape, dtype = _checked_shape(shape), np.dtype(name)
    size = math.prod(shape) * dtype.itemsize
    if dtype.kind not in "biufSU" or type(data) is not bytes or len(data) < size or size > MOST_BYTES:
        raise ValueError(f"an array of shape {shape} and type {name} does not fit its bytes")
    flat = np.frombuffer(data[:size], dtype)
    return flat.reshape(shape, order="F" if fortran else "C").copy()


def _checked_shape(shape: Any) -> tuple[int, ...]:
    if (
        type(shape) is not tuple
        or len(shape) > 16
        or not all(type(side) is int and 0 <= side < 2**40 for side in shape)
    ):
        raise ValueError(f"an array has the shape {shape!r:.60}")
    return shape


class _Maker:
    """A function that a pickle may call but not change."""

    __slots__ = ("_make",)

    def __init__(self, make: Callable[..., Any]):
        self._make = make

    def __call__(self, *arguments: Any) -> Any:
        return self._make(*arguments)

    def __setstate__(self, state: Any) -> None:
        raise ValueError("it changes a function")


_MAKERS = {
    "ndarray": _Maker(_Array),
    "dtype": _Maker(_Dtype),
    "_reconstruct": _Maker(_Array),
    "scalar": _Maker(_scalar),
    "_frombuffer": _Maker(_from_buffer),
    "encode": _Maker(_encode),
}
_ALLOWED = {
    ("_codecs", "encode"),
    ("numpy", "ndarray"),
    ("numpy", "dtype"),
    *((f"numpy.{core}.multiarray", name) for core in ("core", "_core") for name in ("_reconstruct", "scalar")),
    *((f"numpy.{core}.numeric", "_frombuffer") for core in ("core", "_core")),
}
"""Functions and classes that pickles of arrays name."""


class _Restricted(pickle._Unpickler):  # pyright: ignore[reportAttributeAccessIssue]
    """Unpickler in Python, which unlike the one in C reserves no memory that the file asks for."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED:
            raise ValueError(f"it names {module:.60}.{name:.60}, which could run code")
        return _MAKERS[name]

    def get_extension(self, code: int) -> None:
        raise ValueError("it uses extension codes")

    def persistent_load(self, pid: Any) -> None:
        raise ValueError("it refers to objects outside of the file")


def _plain(value: Any, count: list[int], depth: int) -> Any:
    """Copy a value with arrays in place of what they are made of; refuses anything else."""
    count[0] += 1
    if depth > _MOST_DEPTH or count[0] > _MOST_VALUES:
        raise ValueError("its values are nested too deeply, or too many")
    if isinstance(value, _Array):
        value = value.content
    if isinstance(value, np.ndarray) or type(value) in _PLAIN:
        return value
    if type(value) in (list, tuple):
        return [_plain(item, count, depth + 1) for item in value]
    if type(value) is dict and all(type(key) in _PLAIN for key in value):
        return {key: _plain(item, count, depth + 1) for key, item in value.items()}
    raise ValueError(f"it holds a {type(value).__name__}")
