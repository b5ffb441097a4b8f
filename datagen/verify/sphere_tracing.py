"""Intersect rays with exact solids by sphere tracing (Hart 1996, The Visual Computer 12)."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from datagen.shapes.shape import OrientedBox

STEPS = 256
"""Largest number of steps per ray; rays undecided by then run along a surface and may or may not meet it."""

LEAST_STEP = 5e-5
"""Least step of a ray, metres; keeps it moving where the distance vanishes."""

SignedDistance = Callable[[Float[np.ndarray, "point 3"]], Float[np.ndarray, "point"]]


def trace(
    signed_distance: SignedDistance,
    origins: Float[np.ndarray, "ray 3"],
    directions: Float[np.ndarray, "ray 3"],
    near: Float[np.ndarray, "ray"],
    far: Float[np.ndarray, "ray"],
    depth_inside: float | Float[np.ndarray, "ray"],
) -> tuple[Float[np.ndarray, "ray"], Float[np.ndarray, "ray"]]:
    """Find the first point of each ray that lies `depth_inside` metres below the surface.

    Returns:
        Position of that point in units of the ray's direction; inf if there is none between `near` and `far`, which
        are in the same units.
        Least signed distance up to that point, metres; never positive for rays that stay undecided.
    """
    hit, closest = np.full(len(near), np.inf), np.full(len(near), np.inf)
    aim = np.broadcast_to(depth_inside, near.shape)
    t, active = near.copy(), np.flatnonzero(near <= far)
    speed = np.sqrt(np.sum(directions**2, axis=1))
    for _ in range(STEPS):
        if not len(active):
            break
        distance = signed_distance(origins[active] + t[active, None] * directions[active])
        closest[active] = np.minimum(closest[active], distance)
        inside = distance <= -aim[active]
        hit[active[inside]] = t[active[inside]]
        # The last step ends at `far`, since a surface just before it must not be stepped over.
        ends = t[active] >= far[active]
        step = np.maximum(distance + aim[active], LEAST_STEP) / speed[active]
        t[active] = np.minimum(t[active] + step, far[active])
        active = active[~inside & ~ends]
    closest[active] = np.minimum(closest[active], 0.0)
    return hit, closest


def clip_to_box(
    box: OrientedBox, origins: Float[np.ndarray, "ray 3"], directions: Float[np.ndarray, "ray 3"], margin: float
) -> tuple[Float[np.ndarray, "ray"], Float[np.ndarray, "ray"]]:
    """Intersect rays with a box grown by `margin` metres on every side.

    Returns entry and exit of each ray in units of its direction; for rays that miss the box, exit is before entry.
    """
    local_origins = (origins - box.center) @ box.rotation
    local_directions = directions @ box.rotation
    half = 0.5 * box.size + margin
    safe = np.where(np.abs(local_directions) > 1e-12, local_directions, 1e-12)
    first, second = (-half - local_origins) / safe, (half - local_origins) / safe
    near = np.max(np.minimum(first, second), axis=1)
    return np.maximum(near, 0.0), np.min(np.maximum(first, second), axis=1)
