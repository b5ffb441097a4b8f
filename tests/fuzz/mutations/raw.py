"""Damage to the bytes of any file."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
from numpy.random import Generator

from tests.fuzz.mutations.draw import Mutator, pick


def flip_bits(path: Path, rng: Generator) -> str:
    """Flip one bit, or several; half of them in what describes the data."""
    data = bytearray(path.read_bytes())
    places = [_place(path, len(data), rng) for _ in range(pick(rng, (1, 1, 1, 2, 16)))]
    for place in places if data else ():
        data[place] ^= 1 << int(rng.integers(8))
    path.write_bytes(data)
    return f"at {places}"


def cut(path: Path, rng: Generator) -> str:
    """Lose the end."""
    size = path.stat().st_size
    left = pick(rng, (0, 1, size // 2, max(0, size - 1), int(rng.integers(size + 1))))
    os.truncate(path, left)
    return f"to {left} of {size} bytes"


def overwrite_block(path: Path, rng: Generator) -> str:
    """Lose a block to zeros, ones or noise."""
    data = bytearray(path.read_bytes())
    start, length = _place(path, len(data), rng), pick(rng, (1, 4, 8, 64, 512))
    noise = rng.bytes(length)
    block = pick(rng, (bytes(length), b"\xff" * length, noise))[: len(data) - start]
    data[start : start + len(block)] = block
    path.write_bytes(data)
    return f"{len(block)} bytes at {start}"


def shift(path: Path, rng: Generator) -> str:
    """Insert, remove, repeat or append some bytes."""
    data = path.read_bytes()
    start, length = _place(path, len(data), rng), pick(rng, (1, 3, 100))
    how = pick(rng, ("insert", "remove", "repeat", "append"))
    middle = {"insert": rng.bytes(length), "remove": b"", "repeat": data[start : start + length] * 2, "append": b""}
    rest = data[start:] if how in ("insert", "append") else data[start + length :]
    path.write_bytes(data[:start] + middle[how] + rest + (rng.bytes(length) if how == "append" else b""))
    return f"{how} {length} bytes at {start}"


def _place(path: Path, size: int, rng: Generator) -> int:
    """A place in the file, with a chance of one half in its headers and tables."""
    if not size:
        return 0
    if rng.random() < 0.5:
        start, end = pick(rng, described(path))
        return min(size - 1, int(rng.integers(start, max(start + 1, min(size, end)))))
    return int(rng.integers(size))


def described(path: Path) -> list[tuple[int, int]]:
    """Parts of a file that are no pixels and no weights, as first byte and the byte after the last."""
    size = path.stat().st_size
    if path.suffix == ".h5":
        return _described_hdf5(path, size)
    if path.suffix == ".safetensors":
        return [(0, 8), (8, 8 + int.from_bytes(path.read_bytes()[:8], "little"))]
    if path.suffix in (".npy", ".npz", ".png", ".jpg", ".tif"):
        return [(0, 64), (0, 160), (max(0, size - 200), size)]
    return [(0, size)]


def _described_hdf5(path: Path, size: int) -> list[tuple[int, int]]:
    stored: list[tuple[int, int]] = []

    def note(_name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or item.shape is None:
            return
        if item.chunks is None:
            stored.append((item.id.get_offset() or size, item.id.get_storage_size()))
            return
        chunks = (item.id.get_chunk_info(i) for i in range(item.id.get_num_chunks()))
        stored.extend((chunk.byte_offset, chunk.size) for chunk in chunks)

    with h5py.File(path, "r") as file:
        file.visititems(note)
    ends = [0, *(offset + length for offset, length in sorted(stored))]
    starts = [*(offset for offset, _ in sorted(stored)), size]
    return [(a, b) for a, b in zip(ends, starts, strict=True) if a < b]


BYTES: Sequence[Mutator] = (flip_bits, flip_bits, flip_bits, cut, overwrite_block, shift)
