"""Other headers, types, shapes and values in NPY and NPZ files."""

import io
import struct
import zipfile
from pathlib import Path

import numpy as np
from numpy.random import Generator

from tests.fuzz.mutations.draw import pick
from tests.fuzz.mutations.json_values import PLAIN

DTYPES = ("f8", "f4", "f2", "i8", "i1", "u1", "u4", "?", "c16", "S5", ">f4", ">u2")


def change_array(path: Path, rng: Generator) -> str:
    """An NPY file with another header, type, shape or other values; of pickled dicts, one value is changed."""
    array = np.load(path, allow_pickle=True)
    content, change = _changed_dicts(array, rng) if array.dtype == object else changed_npy(array, rng)
    path.write_bytes(content)
    return change


def change_member(path: Path, rng: Generator) -> str:
    """An NPZ file in which one array is changed, gone, or there twice."""
    with np.load(path) as file:
        members = [(f"{name}.npy", _npy(file[name])) for name in file.files]
    place, how = int(rng.integers(len(members))), pick(rng, ("change", "change", "change", "gone", "twice", "text"))
    name, content = members[place]
    if how == "change":
        content, change = changed_npy(np.load(io.BytesIO(content)), rng)
        members[place], how = (name, content), f"change, {change}"
    elif how == "text":
        members[place] = (name, b"nonsense")
    else:
        members[place : place + 1] = [] if how == "gone" else [members[place]] * 2
    with zipfile.ZipFile(path, "w") as archive:
        for each, stored in members:
            info = zipfile.ZipInfo(each)  # a date that is always the same
            archive.NameToInfo.pop(each, None)  # no warning about names that are there twice
            archive.writestr(info, stored)
    return f"{how} of {name}"


def bomb(path: Path, rng: Generator) -> str:
    """An NPZ file of few bytes whose first array has 600 MiB."""
    with np.load(path) as file:
        name = file.files[0]
    info = zipfile.ZipInfo(f"{name}.npy")
    info.compress_type = zipfile.ZIP_DEFLATED
    archive = zipfile.ZipFile(path, "w", compresslevel=1)
    with archive, archive.open(info, "w", force_zip64=True) as member:
        shape = (2, 1, 600 * 2**20 // 2)
        np.lib.format.write_array_header_1_0(member, {"descr": "|u1", "fortran_order": False, "shape": shape})
        for _ in range(600):
            member.write(bytes(2**20))
    return f"{name} of {path.stat().st_size} bytes in the file"


def changed_npy(array: np.ndarray, rng: Generator) -> tuple[bytes, str]:
    """The bytes of an NPY file like one of this array but for one thing, and what that is."""
    how = pick(rng, ("dtype", "dtype", "shape", "shape", "values", "values", "header", "header", "object"))
    if how == "header":
        return _other_header(array, rng)
    if how == "object":
        file = io.BytesIO()
        np.save(file, np.array([{"a": 1}, None], object), allow_pickle=True)
        return file.getvalue(), "objects"
    if how == "dtype":
        dtype = pick(rng, (*DTYPES, "U3", "M8[s]", [("a", "f4"), ("b", "u1")], "V4"))
        return _npy(np.zeros(array.shape, dtype)), f"dtype {dtype}"
    if how == "shape":
        shape = pick(rng, other_shapes(array.shape))
        return _npy(np.resize(array, shape)), f"shape {shape}"
    array = array.copy()
    change = spoil_values(array, rng)
    return _npy(array), change


def _changed_dicts(dicts: np.ndarray, rng: Generator) -> tuple[bytes, str]:
    """Pickled dicts, in one of which, or in a dict in it, one value is changed or gone."""
    facts = pick(rng, dicts.tolist())
    parent = pick(rng, [facts, *(value for value in facts.values() if isinstance(value, dict))])
    key, how = pick(rng, list(parent)), pick(rng, ("replace", "array", "gone", "unsafe"))
    if how == "gone":
        del parent[key]
    elif how == "array":
        shape = np.shape(parent[key])
        array = np.zeros(pick(rng, other_shapes(shape)), pick(rng, DTYPES[:9]))
        spoil_values(array, rng)
        parent[key] = array
    else:
        parent[key] = pick(rng, PLAIN) if how == "replace" else Path("x")
    file = io.BytesIO()
    np.save(file, dicts, allow_pickle=True)
    return file.getvalue(), f"{how} {key}"


def _other_header(array: np.ndarray, rng: Generator) -> tuple[bytes, str]:
    shape, descr = array.shape, array.dtype.str
    header = pick(
        rng,
        (
            f"{{'descr': '{descr}', 'fortran_order': False, 'shape': (100000, 1000000), }}",
            f"{{'descr': '{descr}', 'fortran_order': False, 'shape': ({2**63},), }}",
            f"{{'descr': '{descr}', 'fortran_order': False, 'shape': (-1, 4), }}",
            f"{{'descr': '{descr}', 'fortran_order': True, 'shape': {shape}, }}",
            f"{{'descr': '{descr}', 'fortran_order': False, 'shape': 4, }}",
            f"{{'descr': '{descr}', 'fortran_order': False}}",
            f"{{'descr': 'zz', 'fortran_order': False, 'shape': {shape}, }}",
            f"{{'descr': ('<f4', ({2**31},)), 'fortran_order': False, 'shape': {shape}, }}",
            f"{{'descr': None, 'fortran_order': 3, 'shape': {shape}, }}",
            "(" * 2000,
            "-" * 9000 + "1",
            "[1, 2",
            "",
            "\0" * 40,
        ),
    )
    version, text = pick(rng, ((1, 0), (2, 0), (3, 0), (9, 9))), header.encode("latin1") + b"\n"
    length = struct.pack("<H" if version == (1, 0) else "<I", len(text))
    return b"\x93NUMPY" + bytes(version) + length + text + array.tobytes(), f"header {header[:70]!r}"


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def other_shapes(shape: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Shapes that are not this one."""
    changed = [(*shape[:axis], size, *shape[axis + 1 :]) for axis in range(len(shape)) for size in (0, 1, 2, 7)]
    return [(), (0,), (1,), (5,), (1, *shape), (*shape, 1), shape[1:], shape[::-1], *changed]


def spoil_values(array: np.ndarray, rng: Generator) -> str:
    """Set one value, or all, to an extreme one of its type."""
    kind = array.dtype.kind
    if not array.size or kind not in "biuf":
        return "nothing"
    limits = np.iinfo(array.dtype) if kind in "iu" else None
    extremes = (limits.min, limits.max, 0, 1) if limits else (np.nan, np.inf, -np.inf, 1e30, -1, 0)
    value = pick(rng, extremes if kind != "b" else (True, False))
    place = pick(rng, (..., np.unravel_index(int(rng.integers(array.size)), array.shape)))
    with np.errstate(over="ignore"):
        array[place] = value
    return f"values {value} {'everywhere' if place is ... else 'in one place'}"
