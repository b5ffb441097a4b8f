"""Check cameras: rigid poses, and that they are those of the cameras file or move as the recipe says."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from datagen.config import Recipe
from datagen.verify.scene_case import Case, Finding, rigid_poses

RIGID = 1e-6
"""Largest deviation of a pose from a rigid one."""

ROUNDING = 5e-6
"""Metres and radians that rounding of a description moves a camera."""

DEVIATIONS = 5.0
"""Largest excursion of a handheld camera in its standard deviations: three waves, relative to the first frame."""

PATHS = "camera/world_from_camera_of_frame"


def check_paths(case: Case) -> Iterator[Finding]:
    """Check that poses of moving cameras are rigid and begin with the pose of frame 0."""
    poses = case.record[PATHS]
    product = np.swapaxes(poses[..., :3, :3], -1, -2) @ poses[..., :3, :3]
    if np.max(np.abs(product - np.eye(3))) > RIGID or np.any(np.linalg.det(poses[..., :3, :3]) < 0):
        yield Finding("cameras", f"{PATHS} holds matrices that are no rigid poses")
    if np.any(poses[..., 3, :] != [0, 0, 0, 1]):
        yield Finding("cameras", f"{PATHS} holds matrices with another last row than 0 0 0 1")
    if np.any(poses[0] != case.record["camera/world_from_camera"]):
        yield Finding("cameras", "camera/world_from_camera is not the pose of frame 0")


def check_cameras(
    record: Mapping[str, np.ndarray], recipe: Recipe, views: Sequence[Mapping[str, Any]]
) -> Iterator[Finding]:
    """Check a scene's cameras against the views of a cameras file or, if there are none, the motion of the recipe."""
    stored = record["camera/world_from_camera"]
    poses = np.asarray(record.get(PATHS, stored[None]))
    if views:
        yield from _check_file(record, poses, views)
    elif PATHS in record:
        for view in range(len(stored)):
            if message := _MOTIONS[recipe.rig.motion](poses[:, view], recipe, 2 * np.pi * view / len(stored)):
                yield Finding("cameras", message, view=view)


def _check_file(
    record: Mapping[str, np.ndarray], poses: Float[np.ndarray, "frame view 4 4"], views: Sequence[Mapping[str, Any]]
) -> Iterator[Finding]:
    for number, view in enumerate(views):
        values = np.array(view["poses"], np.float64)[:, None]
        expected = rigid_poses(values[..., :3], values[..., 3:])[:, 0]
        if np.max(np.abs(poses[:, number] - expected)) > ROUNDING:
            yield Finding("cameras", "poses are not those of the cameras file", view=number)
        if "segmentation" in record:
            height, width = record["segmentation"].shape[2:]
            x, y = width / view["width"], height / view["height"]
            k = [[view["fx"] * x, 0, view["cx"] * x], [0, view["fy"] * y, view["cy"] * y], [0, 0, 1]]
            if np.max(np.abs(record["camera/K"][number] - k)) > ROUNDING * max(view["fx"] * x, view["fy"] * y):
                yield Finding("cameras", "camera/K is not that of the cameras file", view=number)


def _wrong_orbit(poses: Float[np.ndarray, "frame 4 4"], recipe: Recipe, angle: float) -> str | None:
    target = _turned(np.array(recipe.rig.target), angle)
    away = poses[:, :3, 3] - target
    around = np.arctan2(away[:, 1], away[:, 0])
    expected = around[0] + np.linspace(0, np.radians(recipe.rig.orbit), len(poses))
    # Steps may be longer than half a turn, so that angles are compared modulo a full one.
    turned = np.angle(np.exp(1j * (around - expected)))
    radius = np.hypot(away[:, 0], away[:, 1])
    error = max(np.max(np.abs(turned) * radius), np.ptp(radius), np.ptp(away[:, 2]))
    if error > 2 * ROUNDING:
        return f"the orbit is up to {1e3 * error:.3f} mm off"
    return _wrong_aim(poses, target)


def _wrong_line(poses: Float[np.ndarray, "frame 4 4"], recipe: Recipe, angle: float) -> str | None:
    way = _turned(np.array(recipe.rig.travel), angle)
    expected = poses[0, :3, 3] + np.linspace(0, 1, len(poses))[:, None] * way
    error = np.max(np.abs(poses[:, :3, 3] - expected))
    if error > 2 * ROUNDING:
        return f"the straight path is up to {1e3 * error:.3f} mm off"
    return _wrong_aim(poses, _turned(np.array(recipe.rig.target), angle))


def _wrong_aim(poses: Float[np.ndarray, "frame 4 4"], target: Float[np.ndarray, "3"]) -> str | None:
    away = target - poses[:, :3, 3]
    distance = np.sqrt(np.sum(away**2, axis=1))
    error = np.max(np.abs(away / distance[:, None] - poses[:, :3, 2]) * np.maximum(distance, 1)[:, None])
    return f"a camera looks {error:.2g} rad past its target" if error > 3 * ROUNDING else None


def _wrong_tremor(poses: Float[np.ndarray, "frame 4 4"], recipe: Recipe, angle: float) -> str | None:
    shift = np.max(np.abs(poses[:, :3, 3] - poses[0, :3, 3]))
    cosine = 0.5 * (np.trace(poses[0, :3, :3].T @ poses[:, :3, :3], axis1=1, axis2=2) - 1)
    turn = np.max(np.arccos(np.clip(cosine, -1, 1)))
    if shift > DEVIATIONS * recipe.rig.shake + ROUNDING:
        return f"a handheld camera moves by {1e3 * shift:.1f} mm, more than rig.shake {recipe.rig.shake} allows"
    if turn > np.sqrt(3) * DEVIATIONS * np.radians(recipe.rig.sway) + 1e-5:
        return f"a handheld camera turns by {np.degrees(turn):.1f} degrees, more than rig.sway {recipe.rig.sway} allows"
    return None


def _turned(vector: Float[np.ndarray, "3"], angle: float) -> Float[np.ndarray, "3"]:
    """A vector turned about the vertical."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1], vector[2]])


_MOTIONS = {
    "still": lambda poses, recipe, angle: "cameras move, but the recipe's are still",
    "orbit": _wrong_orbit,
    "linear": _wrong_line,
    "handheld": _wrong_tremor,
}
"""Description of what is wrong with a view's path, by the recipe's motion; None if nothing is."""
