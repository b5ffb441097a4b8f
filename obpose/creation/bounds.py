"""The world that a model knows: fields say nothing of what lies outside the background's cube."""

from jaxtyping import Float
from torch import Tensor

from obpose.creation.scene import Scene
from obpose.errors import UsageError
from obpose.model import ObPose


def world_bounds(model: ObPose) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Lowest and highest corner of the cube that holds workspace and cameras, world frame, metres."""
    half = model.config.model.background_size / 2
    return model.center - half, model.center + half


def check_inside(scene: Scene, model: ObPose) -> None:
    """Check that all objects are where the model knows the world, in all frames.

    Raises:
        UsageError: some are not; says which.
    """
    low, high = world_bounds(model)
    outside = ((scene.center < low) | (scene.center > high)).any(dim=2).any(dim=0).tolist()
    names = [str(name) for name, out in zip(scene.ids, outside, strict=True) if out]
    if names:
        x, y, z = model.center.tolist()
        raise UsageError(
            f"Object {', '.join(names)} would be outside the world that the model knows, a cube of "
            f"{float(high[0] - low[0]):.2f} m around {x:.2f}, {y:.2f}, {z:.2f}."
        )
