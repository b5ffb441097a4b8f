"""Damage to files: flipped bits and lost bytes in all, other types, shapes and values in those of known formats."""

from collections.abc import Sequence
from pathlib import Path

from numpy.random import Generator

from tests.fuzz.mutations.arrays import bomb, change_array, change_member
from tests.fuzz.mutations.draw import Mutator, pick
from tests.fuzz.mutations.glb import change_glb
from tests.fuzz.mutations.hdf5 import change_attribute, change_hdf5
from tests.fuzz.mutations.images import huge_picture, other_format, other_mode
from tests.fuzz.mutations.json_values import change_json, change_spec
from tests.fuzz.mutations.places import PLACES
from tests.fuzz.mutations.raw import BYTES
from tests.fuzz.mutations.tensors import change_metadata, change_tensor, change_tensors_header
from tests.fuzz.mutations.texts import change_cell, not_a_table, replace_word

FORMATS: dict[str, Sequence[Mutator]] = {
    "dataset.json": (change_json, change_spec, change_spec),
    ".json": (change_json,),
    ".csv": (change_cell, change_cell, change_cell, not_a_table),
    ".h5": (change_hdf5, change_hdf5, change_hdf5, change_attribute),
    ".safetensors": (change_tensors_header, change_metadata, change_tensor, change_tensor),
    ".npy": (change_array,),
    ".glb": (change_glb,),
    ".stl": BYTES,
    ".npz": (*(change_member,) * 11, bomb),
    ".png": (other_mode, other_mode, other_format, huge_picture),
    ".jpg": (other_mode, other_format, huge_picture),
    ".tif": (other_mode, other_format, huge_picture),
    ".webp": (other_mode, other_format, huge_picture),
}
"""By a file's name or ending."""


def mutate(path: Path, rng: Generator) -> str:
    """Damage a file: its bytes, what a reader of its format finds in it, or what kind of thing it is."""
    kind = rng.random()
    formats = FORMATS.get(path.name) or FORMATS.get(path.suffix, (replace_word,))
    mutator: Mutator = pick(rng, BYTES if kind < 0.45 else formats if kind < 0.96 else PLACES)
    return f"{mutator.__name__}: {mutator(path, rng)}"
