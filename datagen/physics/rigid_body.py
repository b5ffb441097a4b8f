"""A shape as a rigid body for an engine: principal axes of inertia, hulls, quaternions."""

import contextlib
import tempfile
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from datagen.errors import DatagenError
from datagen.geometry import quaternion_from_rotation


def principal_axes(inertia: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "4"]]:
    """Principal moments, and the rotation (quaternion) from the principal frame to the object frame.

    The identity where the object frame is one already, so that shapes with equal moments are not turned by rounding.
    """
    diagonal = np.diag(inertia)
    if np.max(np.abs(inertia - np.diag(diagonal))) < 1e-6 * np.max(diagonal):
        return diagonal, np.array([1.0, 0.0, 0.0, 0.0])
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return moments, quaternion_from_rotation(axes)


def wavefront(parts: Sequence[Float[np.ndarray, "_ 3"]]) -> str:
    """The text of an OBJ file with one object for each part; its faces only name the corners, three at a time."""
    texts, first = [], 1
    for number, part in enumerate(parts):
        count, last = -(-len(part) // 3), first + len(part)
        corners = (*range(first, last), *[last - 1] * (3 * count - len(part)))
        # One formatting of all lines is faster than one for each.
        texts.append(f"o part{number}\n" + "v %r %r %r\n" * len(part) % tuple(part.ravel().tolist()))
        texts.append("f %d %d %d\n" * count % corners)
        first = last
    return "".join(texts)


@contextlib.contextmanager
def wavefront_file(parts: Sequence[Float[np.ndarray, "_ 3"]]) -> Iterator[str]:
    """Path of a temporary OBJ file with one object for each part.

    Raises:
        DatagenError: it cannot be written, for example because the disk is full.
    """
    try:
        with tempfile.NamedTemporaryFile("w", suffix=".obj") as file:
            file.write(wavefront(parts))
            file.flush()
            yield file.name
    except OSError as error:
        raise DatagenError(
            f"Cannot write a temporary file in {tempfile.tempdir or 'any folder'}: {error.strerror}. "
            "Make room there, or name another folder in TMPDIR, and run the same command."
        ) from error


def shrink(part: Float[np.ndarray, "corner 3"], margin: float) -> Float[np.ndarray, "corner 3"]:
    """Pull a hull's corners in by a margin (metres) along the axes, to compensate the engine's collision margin."""
    low, high = np.minimum.reduce(part), np.maximum.reduce(part)
    extent, middle = np.maximum(high - low, 1e-9), (low + high) / 2
    return middle + (part - middle) * np.maximum(1 - 2 * margin / extent, 0.05)


def multiply(a: Float[np.ndarray, "4"], b: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
    """Product of two quaternions (w, x, y, z): the rotation b, then a."""
    aw, ax, ay, az = a.tolist()
    bw, bx, by, bz = b.tolist()
    return np.array(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ]
    )


def xyzw(quaternion_wxyz: Float[np.ndarray, "4"]) -> list[float]:
    """Convert a quaternion from (w, x, y, z) to PyBullet's order (x, y, z, w)."""
    w, x, y, z = quaternion_wxyz.tolist()
    return [x, y, z, w]
