"""Damage is the same for the same seed, and there is some."""

import json
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import trimesh
from PIL import Image
from safetensors.numpy import save_file

from tests.fuzz.mutations import mutate
from tests.fuzz.mutations.raw import described

SEEDS = 30


def write_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.attrs["split"] = "train"
        file.create_dataset("depth", data=np.arange(64, dtype=np.uint16).reshape(2, 32), chunks=(1, 32), compression=1)
        file["texts"] = np.array([b'{"a": 1}', b"b"])


def write_safetensors(path: Path) -> None:
    save_file({"a": np.ones((2, 3), np.float32), "b": np.arange(4)}, path, metadata={"info": json.dumps({"step": 1})})


WRITERS: dict[str, Callable[[Path], object]] = {
    "facts.json": lambda path: path.write_text(json.dumps({"a": [1, 2.5, "x"], "b": {"c": None}})),
    "table.csv": lambda path: path.write_text("step,loss\n1,2.5\n2,1.5\n"),
    "pose.txt": lambda path: path.write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"),
    "shard.h5": write_hdf5,
    "model.safetensors": write_safetensors,
    "depth.npy": lambda path: np.save(path, np.ones((4, 5), np.float32)),
    "clip.npy": lambda path: np.save(path, np.array([{"rgb": np.ones(3), "misc": {"fx": 1}}], object)),
    "box.glb": lambda path: trimesh.creation.box().export(path),
    "box.stl": lambda path: trimesh.creation.box().export(path),
    "labels.npz": lambda path: np.savez(path, labels=np.zeros((2, 1, 4, 4), np.uint8), background_slot=0),
    "image.png": lambda path: Image.new("RGB", (8, 6)).save(path),
    "image.jpg": lambda path: Image.new("RGB", (8, 6)).save(path),
    "image.webp": lambda path: Image.new("RGB", (8, 6)).save(path),
    "image.tif": lambda path: Image.new("F", (8, 6)).save(path),
}


def damaged(folder: Path, name: str, seed: int) -> tuple[str, bytes | None]:
    """Description of the change, and the file's content after it; None if there is no file."""
    folder.mkdir(exist_ok=True)
    WRITERS[name](folder / name)
    change = mutate(folder / name, np.random.default_rng(seed))
    found = (folder / name).read_bytes() if (folder / name).is_file() and not (folder / name).is_symlink() else None
    if (folder / name).is_dir():
        (folder / name).rmdir()
    (folder / name).unlink(missing_ok=True)
    return change, found


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", WRITERS)
def test_a_seed_stands_for_one_damage(tmp_path: Path, name: str):
    WRITERS[name](tmp_path / name)
    valid, seen, unchanged = (tmp_path / name).read_bytes(), set(), 0
    for seed in range(SEEDS):
        change, found = damaged(tmp_path / "w", name, seed)
        assert damaged(tmp_path / "w", name, seed) == (change, found)
        seen.add(change.split(":")[0])
        unchanged += found == valid
    assert len(seen) >= 4
    assert unchanged < SEEDS / 10


def test_what_describes_a_shard_is_all_of_it_but_its_data(tmp_path: Path):
    write_hdf5(tmp_path / "shard.h5")
    with h5py.File(tmp_path / "shard.h5") as file:
        chunks = [file["depth"].id.get_chunk_info(number) for number in range(2)]
        data = {byte for chunk in chunks for byte in range(chunk.byte_offset, chunk.byte_offset + chunk.size)}
        texts = file["texts"].id
        data |= {*range(texts.get_offset(), texts.get_offset() + texts.get_storage_size())}
    found = {byte for start, end in described(tmp_path / "shard.h5") for byte in range(start, end)}
    assert found == {*range((tmp_path / "shard.h5").stat().st_size)} - data
