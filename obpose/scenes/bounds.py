"""Where objects can be put: the workspace that the model was trained on, from the table up."""

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.errors import UsageError
from obpose.model.obpose import ObPose
from obpose.scenes.scene import Scene

TABLE = 0.0
"""Height of the table in the world frame, metres."""
_SUNK = 0.01
"""Metres that the middle of a box may lie below the table nevertheless: of thin objects that a model infers some do."""


def workspace_bounds(model: ObPose) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Lowest and highest corner of where the middles of objects' boxes can be, world frame, metres.

    It is the cube that holds what the cameras saw in training, without what is below the table of models that have one:
    elsewhere no object was ever seen, and below the table none is drawn.
    """
    settings = model.config.model
    half = settings.workspace_size / 2
    low, high = model.center - half, model.center + half
    if settings.table is not None:
        low = torch.cat([low[:2], low[2:].clamp(min=TABLE)])
    return low, high


def check_inside(scene: Scene, model: ObPose) -> None:
    """Check that all objects are where the model knows the world, in all frames.

    Raises:
        UsageError: some are not; says which, and where they can be.
    """
    low, high = workspace_bounds(model)
    lowest = low - torch.tensor([0.0, 0.0, _SUNK])
    outside = ((scene.center < lowest) | (scene.center > high)).any(dim=2).any(dim=0).tolist()
    names = [str(name) for name, out in zip(scene.ids, outside, strict=True) if out]
    if names:
        within = zip("xyz", (low * 100).ceil() / 100, (high * 100).floor() / 100, strict=True)
        ranges = [f"{axis} {a:.2f} to {b:.2f}" for axis, a, b in within]
        raise UsageError(
            f"Object {', '.join(names)} would be outside the workspace that the model knows; expected the middle of "
            f"its box at {', '.join(ranges)} m in all frames: put it there, or in frames of your own move the world."
        )
