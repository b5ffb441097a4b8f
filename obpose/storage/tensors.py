"""Read safetensors files, which may come from anybody: sizes, names, types and shapes are checked before the values."""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from datagen.storage.safe_io import brief_reason, check_file
from obpose.errors import CorruptFile
from obpose.storage.pretrained import MOST_BYTES

MOST_HEADER_BYTES = 16 * 2**20
"""Largest header: names, types, shapes, and the curves of a training."""
_NAMED = 3
"""Differences that a message names."""

State = dict[str, Tensor]

_TYPES = {
    "BOOL": torch.bool,
    "U8": torch.uint8,
    "I8": torch.int8,
    "I16": torch.int16,
    "I32": torch.int32,
    "I64": torch.int64,
    "F16": torch.float16,
    "BF16": torch.bfloat16,
    "F32": torch.float32,
    "F64": torch.float64,
}


@dataclass(frozen=True)
class Form:
    """Type and shape of a tensor."""

    dtype: torch.dtype
    shape: tuple[int, ...]

    def __str__(self) -> str:
        return f"{str(self.dtype).removeprefix('torch.')} of shape {list(self.shape)}"


Forms = dict[str, Form]
Check = Callable[[Forms], None]
"""Raises ValueError where the tensors of a file are not those that are expected."""


def forms_of(tensors: Mapping[str, Tensor]) -> Forms:
    """Types and shapes of tensors."""
    return {name: Form(tensor.dtype, tuple(tensor.shape)) for name, tensor in tensors.items()}


def differences_of(found: Forms, expected: Forms) -> str | None:
    """Say how the tensors of a file differ from those that are expected; None if they do not."""
    wrong = [f"{name} is missing" for name in expected.keys() - found.keys()]
    wrong += [f"{name:.80} is unknown" for name in found.keys() - expected.keys()]
    wrong += [
        f"{name} is {found[name]}, expected {form}"
        for name, form in expected.items()
        if name in found and found[name] != form
    ]
    more = f", and {len(wrong) - _NAMED} more" if len(wrong) > _NAMED else ""
    return ", ".join(sorted(wrong)[:_NAMED]) + more if wrong else None


def read_tensors(
    path: Path, advice: str, check: Check | None = None, *, most_bytes: int = MOST_BYTES
) -> tuple[State, dict[str, str]]:
    """Read the tensors and the metadata of a safetensors file.

    Args:
        path: The file.
        advice: What to do where it is damaged: the end of a sentence.
        check: Looks at types and shapes before values are read.
        most_bytes: Its largest size.

    Raises:
        FileNotFoundError: there is no such file.
        UsageError: it is no regular file.
        CorruptFile: it is damaged, too large, or holds NaN or infinity.
    """
    check_file(path, most_bytes)
    try:
        _check_header(path)
        with safe_open(path, framework="pt") as file:
            forms = {name: _form(file, name) for name in file.keys()}  # noqa: SIM118 (not a dict)
            if check:
                check(forms)
            # Copies, because the library maps the file: reading after it was cut short would end the process.
            tensors = {name: file.get_tensor(name).clone() for name in forms}
            metadata = dict(file.metadata() or {})
        if broken := [name for name, tensor in tensors.items() if not tensor.isfinite().all()]:
            raise ValueError(f"{broken[0]} holds NaN or infinity")
    except (SafetensorError, ValueError, TypeError, OverflowError, RuntimeError, UnicodeDecodeError) as error:
        raise CorruptFile(f"{path} is damaged ({brief_reason(error)}); {advice}") from None
    return tensors, metadata


def _check_header(path: Path) -> None:
    """The library would take a header of 100 MB."""
    with path.open("rb") as file:
        first = file.read(8)
    size = struct.unpack("<Q", first)[0] if len(first) == 8 else 0
    if not 0 < size <= MOST_HEADER_BYTES:
        raise ValueError(f"its header would have {size:,} bytes, expected 1 to {MOST_HEADER_BYTES:,}")


def _form(file: safe_open, name: str) -> Form:
    part = file.get_slice(name)
    kind = str(part.get_dtype())
    if kind not in _TYPES:
        raise ValueError(f"{name:.80} is of type {kind}, expected one of {', '.join(_TYPES)}")
    return Form(_TYPES[kind], tuple(part.get_shape()))
