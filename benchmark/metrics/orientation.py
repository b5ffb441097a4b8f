"""Orientation errors of bodies that look the same in several orientations.

Groups are those of `datagen.shapes.symmetry`; continuous ones are handled in closed form and not by sampling.
"""

import numpy as np
from jaxtyping import Float

from datagen.shapes.symmetry import is_continuous, symmetry_rotations

BOX_GROUP = symmetry_rotations("O")
"""The 24 rotations that map the axes of a box to axes of the box."""


def orientation_error(found: Float[np.ndarray, "3 3"], truth: Float[np.ndarray, "3 3"], symmetry: str) -> float:
    """Angle in degrees between an orientation and the nearest one that looks like the true one.

    Rotations are world from object; `symmetry` is the name of the body's exact group in the object's frame. 0 for what
    looks the same however it is turned.

    >>> quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    >>> [round(orientation_error(quarter, np.eye(3), symmetry)) for symmetry in ("C1", "C4")]
    [90, 0]
    """
    return float(_least_angles((truth.T @ found)[None], symmetry)[0])


def box_orientation_error(
    found: Float[np.ndarray, "3 3"],
    truth: Float[np.ndarray, "3 3"],
    symmetry: str,
    box: Float[np.ndarray, "3 3"],
) -> float:
    """Angle between orientations of a box whose axes have no names, in degrees.

    `found` is world from box, its axes named anyhow; `box` holds the axes of the body's box of least volume in the
    object's frame. The object's orientation would be `found @ naming @ box.T` with one of the 24 namings; the one that
    suits the truth best counts.
    """
    return float(_least_angles(truth.T @ found @ BOX_GROUP @ box.T, symmetry).min())


def _least_angles(relative: Float[np.ndarray, "n 3 3"], symmetry: str) -> Float[np.ndarray, "n"]:
    """Degrees between rotations of the object's frame and the nearest rotation of the group."""
    if symmetry == "SO3":
        return np.zeros(len(relative))
    if is_continuous(symmetry):
        # A turn about z can undo all but the tilt of the z axis; Dinf may also turn it upside down.
        up, aside = relative[:, 2, 2], np.hypot(relative[:, 0, 2], relative[:, 1, 2])
        return np.degrees(np.arctan2(aside, np.abs(up) if symmetry.startswith("D") else up))
    group = symmetry_rotations(symmetry)
    # ||A - B||_F = 2 sqrt 2 sin(angle / 2); more exact than the arc cosine of the trace where angles are small.
    chords = np.linalg.norm(relative[:, None] - group, axis=(2, 3)).min(axis=1)
    return np.degrees(2 * np.arcsin(np.minimum(chords / np.sqrt(8.0), 1.0)))
