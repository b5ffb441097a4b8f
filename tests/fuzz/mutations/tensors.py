"""Other headers, types, shapes and values in safetensors files."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from tests.fuzz.mutations.draw import pick
from tests.fuzz.mutations.json_values import NOT_JSON, changed_json


def change_tensors_header(path: Path, rng: Generator) -> str:
    """Another value somewhere in the header of a safetensors file: types, shapes, offsets, metadata."""
    header, data = _read_tensors(path)
    text, change = changed_json(json.dumps(header), rng)
    _write_tensors(path, text, data)
    return change


def change_metadata(path: Path, rng: Generator) -> str:
    """Another value inside what the metadata of a safetensors file says as JSON, or another text."""
    header, data = _read_tensors(path)
    metadata = header.setdefault("__metadata__", {"format": "pt"})
    name = pick(rng, list(metadata))
    try:
        metadata[name], change = changed_json(metadata[name], rng)
    except ValueError:
        metadata[name], change = pick(rng, NOT_JSON)[:100], "another text"
    _write_tensors(path, json.dumps(header), data)
    return f"{name}: {change}"


def change_tensor(path: Path, rng: Generator) -> str:
    """A tensor with another name, type, shape or other values; the file is sound."""
    header, data = _read_tensors(path)
    arrays = {
        name: (facts["dtype"], facts["shape"], data[slice(*facts["data_offsets"])])
        for name, facts in header.items()
        if name != "__metadata__"
    }
    name = pick(rng, sorted(arrays))
    dtype, shape, content = arrays[name]
    how = pick(rng, ("name", "missing", "dtype", "flat", "shape", "values", "values", "extra", "huge"))
    if how == "missing":
        del arrays[name]
    elif how == "name":
        arrays[f"{name}.other"] = arrays.pop(name)
    elif how == "dtype":
        new = pick(rng, ("F64", "F16", "BF16", "I64", "U8", "BOOL"))
        width = {"F64": 8, "F16": 2, "BF16": 2, "I64": 8, "U8": 1, "BOOL": 1}[new]
        how, arrays[name] = f"dtype {new}", (new, shape, bytes(width * int(np.prod(shape))))
    elif how == "flat":
        arrays[name] = (dtype, [int(np.prod(shape))], content)
    elif how == "shape":
        new_shape = pick(rng, ([], [0], [1], [1, *shape], shape[1:], [*shape, 2], [2, *shape[1:]]))
        width = max(1, len(content) // max(1, int(np.prod(shape))))
        needed = width * int(np.prod(new_shape))
        how = f"shape {new_shape}"
        arrays[name] = (
            dtype,
            new_shape,
            (content * (needed // max(1, len(content)) + 1))[:needed].ljust(needed, b"\0"),
        )
    elif how == "values":
        how, arrays[name] = _other_values(dtype, shape, content, rng)
    elif how == "huge":
        arrays[name] = (dtype, [2**40, 0], b"")
    else:
        arrays["unexpected"] = arrays[name]
    out, offset = {"__metadata__": header.get("__metadata__", {})}, 0
    for each, (kind, sizes, stored) in arrays.items():
        out[each] = {"dtype": kind, "shape": sizes, "data_offsets": [offset, offset + len(stored)]}
        offset += len(stored)
    _write_tensors(path, json.dumps(out), b"".join(stored for *_, stored in arrays.values()))
    return f"{how} of {name}"


def _other_values(dtype: str, shape: list[int], content: bytes, rng: Generator) -> tuple[str, tuple[Any, ...]]:
    numpy_type = {"F32": "<f4", "F16": "<f2", "F64": "<f8", "I64": "<i8"}.get(dtype, "u1")
    values = np.frombuffer(content, numpy_type).copy()
    new = pick(rng, (np.nan, np.inf, -np.inf, 0, -1, 1e-30, 1e4, 1e30) if numpy_type[1] == "f" else (0, 1, 100))
    some = pick(rng, (slice(None), slice(0, 1), slice(-1, None)))
    with np.errstate(over="ignore"):
        values[some] = new
    return f"values {new} in {some}", (dtype, shape, values.tobytes())


def _read_tensors(path: Path) -> tuple[dict[str, Any], bytes]:
    data = path.read_bytes()
    end = 8 + int.from_bytes(data[:8], "little")
    return json.loads(data[8:end]), data[end:]


def _write_tensors(path: Path, header: str, data: bytes) -> None:
    text = header.encode("utf-8", "surrogatepass")
    path.write_bytes(struct.pack("<Q", len(text)) + text + data)
