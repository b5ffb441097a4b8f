"""Other values in the JSON part of GLB files."""

import struct
from pathlib import Path

from numpy.random import Generator

from tests.fuzz.mutations.json_values import changed_json

_HEADER = 12


def change_glb(path: Path, rng: Generator) -> str:
    """Another value somewhere in the JSON part of a GLB file; its lengths fit (glTF 2.0, section 4.4)."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, _HEADER)
    start, end = _HEADER + 8, _HEADER + 8 + length
    text, change = changed_json(data[start:end].decode(), rng)
    encoded = text.encode()
    encoded += b" " * (-len(encoded) % 4)
    rest = struct.pack("<I4s", len(encoded), b"JSON") + encoded + data[end:]
    path.write_bytes(data[:8] + struct.pack("<I", _HEADER + len(rest)) + rest)
    return change
