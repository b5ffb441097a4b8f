"""Safetensors files, possibly from untrusted sources: sizes, names, types and shapes are checked before the values.

Files may hold float32 values in fewer bytes (`pack`); `read_tensors` always gives them as float32.
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from datagen.storage.safe_io import brief_reason, check_file
from obpose.errors import CorruptFile
from obpose.storage.pretrained import MOST_BYTES

MOST_HEADER_BYTES = 16 * 2**20
"""Largest header: names, types, shapes, and the curves of a training."""
_LEAST_STEP = 2.0**-24
"""Smallest float16 above 0."""
STEP = ".step"
"""Suffix of the tensor that holds the quantisation steps of an int8 tensor, one for each row."""
_NAMED = 3
"""Number of differences that a message lists."""

Precision = Literal["float32", "float16", "int8"]
"""Type in which float32 values are stored."""

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
Expect = Callable[[Forms], Forms]
"""Give the types and shapes that a file should have, from those that it has; raise an error if there are none."""


def pack(tensors: Mapping[str, Tensor], precision: Precision) -> State:
    """Store float32 values in fewer bytes; other tensors stay as they are.

    float16 keeps 11 significant bits. int8 stores each row (along the first axis) as whole multiples of a float16
    step, at most 127 of them; tensors with fewer than two axes become float16.
    """
    packed: State = {}
    for name, tensor in tensors.items():
        if precision == "float32" or tensor.dtype != torch.float32:
            packed[name] = tensor.contiguous()
        elif precision == "float16" or tensor.ndim < 2:
            packed[name] = tensor.half().contiguous()
        else:
            step = (tensor.abs().flatten(1).amax(dim=1) / 127).clamp(min=_LEAST_STEP).half()
            packed[name] = (tensor / _like_rows(step, tensor)).round().clamp(-127, 127).to(torch.int8).contiguous()
            packed[name + STEP] = step
    return packed


def _like_rows(step: Tensor, rows: Tensor) -> Tensor:
    """Quantisation steps, shaped such that they multiply rows."""
    return step.float().view(-1, *[1] * (rows.ndim - 1))


def forms_of(tensors: Mapping[str, Tensor]) -> Forms:
    """Give the types and shapes of tensors."""
    return {name: Form(tensor.dtype, tuple(tensor.shape)) for name, tensor in tensors.items()}


def differences_of(found: Forms, expected: Forms) -> str | None:
    """Describe how the tensors of a file differ from those that are expected; None if they do not."""
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
    path: Path, advice: str, expect: Expect | None = None, *, most_bytes: int = MOST_BYTES
) -> tuple[State, dict[str, str]]:
    """Read the tensors and the metadata of a safetensors file; values that `pack` made smaller come back as float32.

    `advice` for the user, if the file is damaged, is the end of a sentence. Types and shapes are
    compared with those of `expect` before values are read.

    Raises:
        FileNotFoundError: there is no such file.
        UsageError: the path is not a regular file.
        CorruptFile: the file is damaged, too large, or holds NaN or infinity.
    """
    check_file(path, most_bytes)
    try:
        _check_header(path)
        with safe_open(path, framework="pt") as file:
            forms = {name: _form(file, name) for name in file.keys()}  # noqa: SIM118 (not a dict)
            found = _unpacked_forms(forms)
            if expect and (wrong := differences_of(found, expect(found))):
                raise ValueError(wrong)
            # Copies, because the library maps the file: reading after it was cut short would end the process.
            tensors = {name: file.get_tensor(name).clone() for name in forms}
            metadata = dict(file.metadata() or {})
        if broken := [name for name, tensor in tensors.items() if not tensor.isfinite().all()]:
            raise ValueError(f"{broken[0]} holds NaN or infinity")
    except (SafetensorError, ValueError, TypeError, OverflowError, RuntimeError, UnicodeDecodeError) as error:
        raise CorruptFile(f"{path} is damaged ({brief_reason(error)}); {advice}") from None
    return _unpacked(tensors), metadata


def _is_packed(name: str, forms: Forms) -> bool:
    """Whether a tensor is stored as int8 with a step for each row."""
    form, step = forms[name], forms.get(name + STEP)
    return form.dtype == torch.int8 and len(form.shape) > 1 and step == Form(torch.float16, form.shape[:1])


def _unpacked_forms(forms: Forms) -> Forms:
    """Types and shapes after unpacking."""
    packed = {name for name in forms if _is_packed(name, forms)}
    steps = {name + STEP for name in packed}
    floats = {name for name, form in forms.items() if name in packed or form.dtype == torch.float16}
    return {
        name: Form(torch.float32 if name in floats else form.dtype, form.shape)
        for name, form in forms.items()
        if name not in steps
    }


def _unpacked(tensors: State) -> State:
    """Undo `pack`."""
    forms = forms_of(tensors)
    values = {name: tensors[name].to(form.dtype) for name, form in _unpacked_forms(forms).items()}
    for name in values:
        if _is_packed(name, forms):
            values[name] *= _like_rows(tensors[name + STEP], values[name])
    return values


def _check_header(path: Path) -> None:
    """Check the size of the header; the library itself accepts 100 MB."""
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
