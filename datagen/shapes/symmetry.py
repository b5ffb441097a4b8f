"""Names of rotation groups in the object frame, and their rotations.

`C1` only the identity; `Cn` n-fold about z; `Dn` the same with half turns about x; `Cinf`, `Dinf` with every rotation
about z; `O` the 24 rotations of a cube; `SO3` all rotations. Mirror images do not count: a body cannot be turned into
its mirror image.
"""

import itertools
import re

import numpy as np
from jaxtyping import Float

_NAME = re.compile(r"([CD])([1-9][0-9]*|inf)|O|SO3")


def is_continuous(name: str) -> bool:
    """Whether the group is infinite.

    Raises:
        ValueError: it is no group's name.
    """
    _parse(name)
    return name == "SO3" or name.endswith("inf")


def symmetry_rotations(name: str, steps: int = 36) -> Float[np.ndarray, "rotation 3 3"]:
    """Rotations of the group, the identity first.

    A continuous group is sampled: `steps` angles about each axis that can turn freely (`SO3`: the cube's 24 rotations
    combined with `steps` turns about z).

    Raises:
        ValueError: it is no group's name.
    """
    kind, order = _parse(name)
    if kind == "O":
        return _cube_rotations()
    if kind == "SO3":
        return (about_z(2 * np.pi * np.arange(steps) / steps)[:, None] @ _cube_rotations()).reshape(-1, 3, 3)
    count = steps if order == "inf" else int(order)
    turns = about_z(2 * np.pi * np.arange(count) / count)
    return turns if kind == "C" else np.concatenate([turns, turns @ np.diag([1.0, -1.0, -1.0])])


def name_group(turns: Float[np.ndarray, "rotation 3 3"], axes: Float[np.ndarray, "axis 3"]) -> str | None:
    """Name of the group of the identity, `turns`, and all rotations about unit vectors `axes`.

    None if it has none, because its main axis is not z. Deviations of up to five degrees do not count.
    """
    near = np.cos(np.radians(5))
    if len(axes):
        if np.all(np.abs(axes[:, 2]) > near):
            return "Dinf" if np.any(turns[:, 2, 2] < -near) else "Cinf"
        return "SO3" if len(axes) > 1 else None
    count = len(turns) + 1
    for name in (f"C{count}", f"D{count // 2}", "O"):
        members = symmetry_rotations(name)[1:]
        cosines = (np.einsum("aij,bij->ab", members, turns) - 1) / 2
        if len(members) == len(turns) and np.all(np.sort(cosines, axis=1)[:, -1:] > near):
            return name
    return None


def about_z(angles: Float[np.ndarray, "rotation"]) -> Float[np.ndarray, "rotation 3 3"]:
    """Rotations about the z axis by angles in radians."""
    rotations = np.zeros((len(angles), 3, 3))
    rotations[:, 0, 0] = rotations[:, 1, 1] = np.cos(angles)
    rotations[:, 1, 0] = np.sin(angles)
    rotations[:, 0, 1] = -rotations[:, 1, 0]
    rotations[:, 2, 2] = 1
    return rotations


def _parse(name: str) -> tuple[str, str]:
    match = _NAME.fullmatch(name)
    if match is None:
        raise ValueError(f"{name!r} is no rotation group; expected Cn, Dn (n a number or inf), O or SO3.")
    return match[1] or name, match[2] or ""


def _cube_rotations() -> Float[np.ndarray, "24 3 3"]:
    signed = [
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return np.array([matrix for matrix in signed if np.linalg.det(matrix) > 0])
