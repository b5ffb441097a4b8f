"""Other objects, types, shapes, values, storage and attributes in HDF5 files."""

import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.random import Generator

from tests.fuzz.mutations.arrays import DTYPES, other_shapes, spoil_values
from tests.fuzz.mutations.draw import pick
from tests.fuzz.mutations.json_values import changed_json


def change_hdf5(path: Path, rng: Generator) -> str:
    """Another thing in the place of a dataset: a group, a link, another type, shape, storage, or other values."""
    how = pick(rng, HDF5_CHANGES)
    with h5py.File(path, "r+") as file:
        names = _datasets(file)
        texts = [name for name in names if _dataset(file, name).dtype.kind == "S"]
        if how is other_text and not texts:
            how = other_values
        name = pick(rng, texts if how is other_text else names)
        return f"{how.__name__} {name}: {how(file, name, rng)}"


def change_attribute(path: Path, rng: Generator) -> str:
    """An attribute that is gone, or of another type."""
    with h5py.File(path, "r+") as file:
        holders: list[Any] = [file, *([file["hash"], file] if "hash" in file else []), file[pick(rng, _datasets(file))]]
        holder = pick(rng, [holder for holder in holders if len(holder.attrs)] or [file])
        name = pick(rng, list(holder.attrs) or ["data"])
        with suppress(KeyError):
            del holder.attrs[name]
        values = (
            None, 0, -1, np.nan, 2**62, "", "x", "rgb rgb", "é" * 3000, b"\xff\xfe", np.arange(4), np.zeros((2, 2)),
            np.array(["a", "b"], "S1"), h5py.Empty("f4"), h5py.Empty("S1"), True, 1j, file.ref,
        )  # fmt: skip
        value = pick(rng, values)
        if value is not None:
            holder.attrs[name] = value
        return f"{name} of {holder.name}: {value!r:.30}"


def _datasets(file: h5py.File) -> list[str]:
    names: list[str] = []
    file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
    return names


def _dataset(file: h5py.File, name: str) -> h5py.Dataset:
    found = file[name]
    assert isinstance(found, h5py.Dataset)
    return found


def _replace(file: h5py.File, name: str, **options: Any) -> h5py.Dataset:
    attributes = dict(file[name].attrs)
    del file[name]
    made = file.create_dataset(name, **options)
    made.attrs.update(attributes)
    return made


def a_group(file: h5py.File, name: str, rng: Generator) -> str:
    """A group of that name."""
    del file[name]
    file.create_group(name)
    return "empty"


def missing(file: h5py.File, name: str, rng: Generator) -> str:
    """Nothing, or the same under another name."""
    if rng.random() < 0.3:
        file.move(name, f"{name}_")
        return "renamed"
    del file[name]
    return "deleted"


def a_link(file: h5py.File, name: str, rng: Generator) -> str:
    """A link of some kind."""
    del file[name]
    kind = pick(rng, ("itself", "root", "nowhere", "other", "external", "loop"))
    links = {
        "itself": h5py.SoftLink(f"/{name}"),
        "root": h5py.SoftLink("/"),
        "nowhere": h5py.SoftLink("/nothing"),
        "other": h5py.SoftLink(f"/{_datasets(file)[0]}") if _datasets(file) else h5py.SoftLink("/x"),
        "external": h5py.ExternalLink("/etc/hostname", "/x"),
        "loop": file["/"],
    }
    file[name] = links[kind]
    return kind


def other_type(file: h5py.File, name: str, rng: Generator) -> str:
    """Replace an array by one of equal shape and another type."""
    shape = _dataset(file, name).shape
    kinds: tuple[Any, ...] = (
        *DTYPES, h5py.string_dtype(), h5py.string_dtype(length=4), h5py.ref_dtype, h5py.vlen_dtype("i4"), "V8",
        np.dtype([("a", "f4"), ("b", "u1")]), np.dtype(("f4", (3,))), h5py.enum_dtype({"A": 1}),
    )  # fmt: skip
    kind = pick(rng, kinds)
    _replace(file, name, shape=shape, dtype=kind)
    return str(kind)


def other_shape(file: h5py.File, name: str, rng: Generator) -> str:
    """Replace an array by one of equal type and another shape, filled with the old values."""
    old = np.asarray(_dataset(file, name)[()])
    shape = pick(rng, other_shapes(old.shape))
    _replace(file, name, data=np.resize(old, shape))
    return str(shape)


def no_values(file: h5py.File, name: str, rng: Generator) -> str:
    """A dataset without a shape."""
    _replace(file, name, data=h5py.Empty(_dataset(file, name).dtype))
    return "empty"


def too_large(file: h5py.File, name: str, rng: Generator) -> str:
    """A shape of terabytes, or of 2 GiB, of which next to nothing is stored."""
    old = _dataset(file, name)
    shape, dtype = list(old.shape), old.dtype
    if not shape:
        return "nothing"
    axis, size = int(rng.integers(len(shape))), pick(rng, (2**40, 2**31))
    shape[axis] = max(1, size // max(1, int(np.prod(shape)) // max(1, shape[axis])) // dtype.itemsize)
    chunks = pick(rng, (True, tuple(min(side, 2**20 if place == axis else 1) for place, side in enumerate(shape))))
    _replace(file, name, shape=tuple(shape), dtype=dtype, chunks=chunks, compression="gzip")
    return str(tuple(shape))


def other_values(file: h5py.File, name: str, rng: Generator) -> str:
    """Extreme values."""
    values = np.array(_dataset(file, name)[()])
    change = spoil_values(values, rng)
    _replace(file, name, data=values)
    return change


def other_text(file: h5py.File, name: str, rng: Generator) -> str:
    """Texts with other content; JSON with another value."""
    texts = np.array(_dataset(file, name)[()], object)
    place = pick(rng, list(np.ndindex(texts.shape)))
    old = bytes(texts[place]).decode()
    try:
        new, change = changed_json(old, rng)
    except ValueError:
        new = pick(rng, ("", "x", "ÿ" * 20, "1", "[red]x[/]", "../../x", "a" * 5000))
        change = f"{new[:10]!r}"
    texts[place] = new.encode("utf-8", "surrogatepass") if rng.random() < 0.9 else b"\xff\xfe"
    width = max(1, *(len(text) for text in texts.ravel()))
    _replace(file, name, data=texts.astype(f"S{width}"))
    return change


def other_storage(file: h5py.File, name: str, rng: Generator) -> str:
    """Store an array elsewhere or packed in another way, with equal type and shape."""
    old = _dataset(file, name)
    shape, dtype, values = old.shape, old.dtype, old[()]
    how = pick(rng, ("external", "virtual", "contiguous", "checksum", "a chunk of 400 MiB"))
    if how == "external":
        size = max(1, int(np.prod(shape)) * dtype.itemsize)
        _replace(file, name, shape=shape, dtype=dtype, external=[("/etc/passwd", 0, size)])
    elif how == "virtual":
        attributes = dict(file[name].attrs)
        del file[name]
        layout = h5py.VirtualLayout(shape, dtype)
        if shape:
            layout[...] = h5py.VirtualSource("/etc/hostname", "x", shape)
        file.create_virtual_dataset(name, layout).attrs.update(attributes)
    elif how == "contiguous" or not shape or 0 in shape:
        _replace(file, name, data=values)
    elif how == "checksum":
        _replace(file, name, data=values, chunks=True, fletcher32=True, compression="lzf")
    else:
        chunk = (*(1 for _ in shape[1:]), 400 * 2**20 // dtype.itemsize)
        made = _replace(
            file, name, shape=shape, dtype=dtype, chunks=chunk, maxshape=(None,) * len(shape), compression=1
        )
        made.id.write_direct_chunk((0,) * len(shape), zlib.compress(bytes(400 * 2**20), 1))
    return how


HDF5_CHANGES = (
    a_group, missing, a_link, other_type, other_type, other_shape, other_shape, no_values, too_large, other_values,
    other_values, other_text, other_storage,
)  # fmt: skip
