"""Bounds of objects: the workspace that the model was trained on, above the table."""

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.errors import UsageError
from obpose.model.obpose import ObPose
from obpose.scenes.scene import Scene

TABLE = 0.0
"""Height of the table in the world frame, metres."""
_SUNK = 0.01
"""Tolerance for box centres below the table, metres; inferred thin objects need it."""


def workspace_bounds(model: ObPose) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Give the lowest and highest corner of the allowed box centres, world frame, metres.

    They bound the cube that the cameras saw in training. If the model has a table, the part below it is excluded,
    because nothing is rendered there.
    """
    settings = model.config.model
    half = settings.workspace_size / 2
    low, high = model.center - half, model.center + half
    if settings.table is not None:
        low = torch.cat([low[:2], low[2:].clamp(min=TABLE)])
    return low, high


def objects_outside(scene: Scene, model: ObPose) -> list[int]:
    """Names of the objects that are outside the workspace in some frame."""
    low, high = workspace_bounds(model)
    lowest = low - torch.tensor([0.0, 0.0, _SUNK])
    outside = ((scene.center < lowest) | (scene.center > high)).any(dim=2).any(dim=0).tolist()
    return [name for name, out in zip(scene.ids, outside, strict=True) if out]


def check_inside(scene: Scene, model: ObPose) -> None:
    """Check that all objects are inside the workspace in all frames.

    Raises:
        UsageError: some are outside; the message lists them and the bounds.
    """
    if names := objects_outside(scene, model):
        low, high = workspace_bounds(model)
        within = zip("xyz", (low * 100).ceil() / 100, (high * 100).floor() / 100, strict=True)
        ranges = [f"{axis} {a:.2f} to {b:.2f}" for axis, a, b in within]
        raise UsageError(
            f"Object {', '.join(map(str, names))} would be outside the workspace of the model; expected the middle of "
            f"its box at {', '.join(ranges)} m in all frames: put it there, or in frames of your own move the world."
        )
