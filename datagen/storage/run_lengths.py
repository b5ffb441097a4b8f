"""Masks as COCO's run lengths, plain and compressed."""

import numpy as np
from jaxtyping import Bool, Int64

_ZERO = 48
"""Letter of the number 0."""


def run_lengths(mask: Bool[np.ndarray, "height width"]) -> Int64[np.ndarray, " run"]:
    """Lengths of runs of zeros and ones in turn, column by column, beginning with zeros: COCO's plain `counts`."""
    flat = mask.ravel(order="F")
    ends = np.concatenate([np.flatnonzero(flat[1:] != flat[:-1]) + 1, [len(flat)]])
    counts = np.diff(ends, prepend=0)
    return np.concatenate([[0], counts]) if flat[0] else counts


def encode_mask(mask: Bool[np.ndarray, "height width"]) -> bytes:
    """Encode a mask as COCO's compressed `counts`; `{"size": [height, width], "counts": counts}` is its dictionary.

    From the fourth on, each run's length is stored as the difference to the one two before. Numbers are written in
    groups of five bits, the lowest first, with a sixth bit if another group follows, as letters from `0` on.
    """
    counts = run_lengths(mask)
    numbers = counts.copy()
    numbers[3:] -= counts[1:-2]
    return b"".join(_letters(int(number)) for number in numbers)


def _letters(number: int) -> bytes:
    letters, more = bytearray(), True
    while more:
        group, number = number & 31, number >> 5
        more = number != (-1 if group & 16 else 0)
        letters.append(_ZERO + group + 32 * more)
    return bytes(letters)


def decode_mask(counts: bytes, height: int, width: int) -> Bool[np.ndarray, "height width"]:
    """Decode a mask of `encode_mask`, such as those of `amodal/rle`.

    Raises:
        ValueError: the text is no run lengths of an image of this size.
    """
    lengths: list[int] = []
    for number in _numbers(counts):
        lengths.append(number + lengths[-2] if len(lengths) > 2 else number)
    if sum(lengths) != height * width or min(lengths, default=0) < 0:
        raise ValueError(f"run lengths cover {sum(lengths)} pixels, expected {height} x {width}")
    return np.repeat(np.arange(len(lengths)) % 2 == 1, lengths).reshape((height, width), order="F")


def _numbers(counts: bytes) -> list[int]:
    numbers, value, shift = [], 0, 0
    for letter in counts:
        if not _ZERO <= letter < _ZERO + 64 or shift > 60:
            raise ValueError(f"run lengths hold the letter {letter}, expected letters of COCO's run lengths")
        group = letter - _ZERO
        value |= (group & 31) << shift
        shift += 5
        if not group & 32:
            numbers.append(value - (1 << shift if group & 16 else 0))
            value, shift = 0, 0
    if shift:
        raise ValueError("run lengths end in the middle of a number")
    return numbers
