import json
import os
import re
import struct
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from obpose.errors import CorruptFile, UsageError
from obpose.storage.tensors import (
    MOST_HEADER_BYTES,
    Form,
    Forms,
    Precision,
    differences_of,
    forms_of,
    pack,
    read_tensors,
)

ADVICE = "make it again."
TENSORS = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.zeros(2, dtype=torch.float16)}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    save_file(TENSORS, tmp_path / "x.safetensors", metadata={"note": "here"})
    return tmp_path / "x.safetensors"


def with_header(path: Path, header: dict, data: bytes) -> None:
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data)


def test_what_was_written_is_read(path: Path):
    tensors, metadata = read_tensors(path, ADVICE)
    assert metadata == {"note": "here"}
    assert forms_of(tensors) == {"a": Form(torch.float32, (2, 3)), "b": Form(torch.float32, (2,))}
    assert torch.equal(tensors["a"], TENSORS["a"])


@pytest.mark.parametrize(("precision", "error"), [("float32", 0), ("float16", 2**-11), ("int8", 0.5 / 127)])
def test_packed_values_come_back_as_float32_to_their_precision(tmp_path: Path, precision: Precision, error: float):
    rows = (
        torch.randn(3, 5, 4, generator=torch.Generator().manual_seed(0)) * torch.tensor([1e-3, 1, 50.0])[:, None, None]
    )
    tensors = {"rows": rows, "zeros": torch.zeros(2, 3), "scale": torch.tensor(0.3), "count": torch.tensor([3, 4])}
    save_file(pack(tensors, precision), tmp_path / "packed")
    seen: list[Forms] = []
    found, _ = read_tensors(tmp_path / "packed", ADVICE, lambda forms: seen.append(forms) or forms)
    assert seen == [forms_of(tensors)] == [forms_of(found)]
    allowed = rows.abs().flatten(1).amax(dim=1)[:, None, None] * (error * 1.01)
    assert ((found["rows"] - rows).abs() <= allowed).all()
    assert torch.equal(found["zeros"], tensors["zeros"])
    assert torch.equal(found["count"], tensors["count"])


def test_tensors_outlive_their_file(path: Path):
    tensors, _ = read_tensors(path, ADVICE)
    path.write_bytes(b"")
    assert torch.equal(tensors["a"], TENSORS["a"])


@pytest.mark.parametrize("keep", [0, 4, 8, 20, 100, -1])
def test_a_file_cut_short_is_damage_with_advice(path: Path, keep: int):
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(CorruptFile, match=r"x\.safetensors is damaged \(.*\); make it again\."):
        read_tensors(path, ADVICE)


@pytest.mark.parametrize(
    "header",
    [
        {"a": {"dtype": "F99", "shape": [1], "data_offsets": [0, 4]}},
        {"a": {"dtype": "F32", "shape": [-1], "data_offsets": [0, 4]}},
        {"a": {"dtype": "F32", "shape": [10**12], "data_offsets": [0, 4 * 10**12]}},
        {"a": {"dtype": "F32", "shape": [10**30, 0], "data_offsets": [0, 0]}},
        {"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 4]}},
        {"a": {"dtype": "F8_E4M3", "shape": [4], "data_offsets": [0, 4]}},
        {"a": {"dtype": "F32", "shape": [1]}},
        {"a": 3},
        [],
        {"__metadata__": {"note": 3}},
    ],
)
def test_impossible_headers_are_damage(path: Path, header: dict):
    with_header(path, header, bytes(4))
    with pytest.raises(CorruptFile, match="is damaged"):
        read_tensors(path, ADVICE)


def test_a_huge_header_is_not_read(path: Path):
    path.write_bytes(struct.pack("<Q", MOST_HEADER_BYTES + 1) + b"{}")
    with pytest.raises(CorruptFile, match="its header would have 16,777,217 bytes, expected 1 to 16,777,216"):
        read_tensors(path, ADVICE)


def test_a_nested_header_is_damage(path: Path):
    text = b'{"a":' + b"[" * 100_000
    path.write_bytes(struct.pack("<Q", len(text)) + text)
    with pytest.raises(CorruptFile, match="is damaged"):
        read_tensors(path, ADVICE)


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_numbers_that_are_not_finite_are_damage(path: Path, value: float):
    save_file({"a": torch.tensor([0.0, value])}, path)
    with pytest.raises(CorruptFile, match="a holds NaN or infinity"):
        read_tensors(path, ADVICE)


def test_files_that_are_none_are_refused(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path, tmp_path / "pipe"):
        with pytest.raises(UsageError, match="expected a"):
            read_tensors(place, ADVICE)
    with pytest.raises(FileNotFoundError):
        read_tensors(tmp_path / "nowhere", ADVICE)


def test_a_file_of_another_size_is_not_opened(path: Path):
    with pytest.raises(CorruptFile, match="expected at most 10 for a file of its kind"):
        read_tensors(path, ADVICE, most_bytes=10)


def test_the_check_sees_forms_and_its_complaint_is_damage(path: Path):
    def check(found: Forms) -> None:
        raise ValueError(f"there are {len(found)}")

    with pytest.raises(CorruptFile, match=re.escape("is damaged (there are 2); make it again.")):
        read_tensors(path, ADVICE, check)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, None),
        ({"a": None}, "a is missing"),
        ({"c": torch.zeros(1)}, "c is unknown"),
        ({"a": torch.zeros(3, 2)}, "a is float32 of shape [3, 2], expected float32 of shape [2, 3]"),
        ({"b": torch.zeros(2)}, "b is float32 of shape [2], expected float16 of shape [2]"),
        ({name: torch.zeros(1) for name in "cdefg"}, "c is unknown, d is unknown, e is unknown, and 2 more"),
    ],
)
def test_differences_are_named(change: dict, message: str | None):
    found = {name: tensor for name, tensor in {**TENSORS, **change}.items() if tensor is not None}
    assert differences_of(forms_of(found), forms_of(TENSORS)) == message
