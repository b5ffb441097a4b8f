"""Simulate a noisy depth camera from an exact depth image.

The model, in order; every constant is a field of `config.Sensor`:

1. Holes. A pixel returns nothing with a probability that is the union of three independent causes: it lies beside a
   depth edge (`edge_dropout`); its surface is seen at more than `grazing_angle` from the normal, rising linearly to
   certainty at 90 degrees; its luminance is below `dark_reflectance`, rising linearly to certainty at black.
2. Axial noise. Normal, with standard deviation `axial_noise * z^2`: triangulating sensors measure disparity, whose
   error is constant (Khoshelham and Elberink 2012, Sensors 12, eq. 8; its growth with z^2 is measured there and by
   Nguyen, Izadi and Lovell 2012, 3DIMPVT, whose fit has 1.9 mm at 1 m for its quadratic part, our default).
3. Quantisation. Disparity comes in steps, so inverse depth is rounded to multiples of `quantisation`, which makes depth
   steps of `quantisation * z^2` (Khoshelham and Elberink 2012, section 3.3). Time-of-flight sensors report whole
   millimetres: depth is rounded to multiples of `depth_step`.
4. Range. Nothing returns from before `nearest` or beyond `farthest`.

`datagen.sensor_presets` has the constants of some devices.

Left out: noise along the image (a blur of a pixel or less), the shadow between projector and camera, and correlation
between frames.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from datagen.config import Sensor
from datagen.geometry import LINEAR, pixel_rays
from datagen.schema import MAX_DEPTH

EDGE_JUMP = 0.01
"""Least jump of depth at an edge, metres, unless a pixel's footprint is larger."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear red, green and blue (ITU-R BT.709)."""

Depth = Float[np.ndarray, "height width"]


def sense(
    depth: Float32[np.ndarray, "height width"],
    rgb: UInt8[np.ndarray, "height width 3"],
    k: Float[np.ndarray, "3 3"],
    config: Sensor,
    rng: np.random.Generator,
) -> tuple[Float32[np.ndarray, "height width"], Bool[np.ndarray, "height width"]]:
    """Simulate sensor depth (metres, 0 if nothing returns) and its validity mask from exact planar depth (metres)."""
    # Both draws cover the whole image whatever it shows, so that one pixel never shifts another's noise.
    noise = rng.standard_normal(depth.shape)
    luck = rng.random(depth.shape)
    clean = depth.astype(np.float64)
    measured = _quantised(clean + config.axial_noise * clean**2 * noise, config.quantisation)
    if config.depth_step:
        measured = np.rint(measured / config.depth_step) * config.depth_step
    valid = (depth > 0) & (luck >= hole_probability(clean, rgb, k, config)) & (measured > 0) & (measured <= MAX_DEPTH)
    valid &= (clean >= config.nearest) & (clean <= config.farthest)
    return np.where(valid, measured, 0).astype(np.float32), valid


def hole_probability(
    depth: Depth, rgb: UInt8[np.ndarray, "height width 3"], k: Float[np.ndarray, "3 3"], config: Sensor
) -> Depth:
    """Probability of each pixel to return nothing, from depth edges, grazing angle and darkness together."""
    edge = config.edge_dropout * depth_edges(depth, k)
    span = max(90.0 - config.grazing_angle, 1e-9)
    grazing = np.clip((incidence(depth, k) - config.grazing_angle) / span, 0, 1)
    dark = np.clip(1 - luminance(rgb) / max(config.dark_reflectance, 1e-9), 0, 1) * (config.dark_reflectance > 0)
    return 1 - (1 - edge) * (1 - grazing) * (1 - dark)


def depth_edges(depth: Depth, k: Float[np.ndarray, "3 3"]) -> Bool[np.ndarray, "height width"]:
    """Mask of the pixels whose depth jumps to a neighbour above, below, left or right.

    Inverse depth of a plane is linear in the image, so its second difference vanishes on planes however slanted.
    """
    threshold = np.maximum(EDGE_JUMP, 1.5 * depth / k[0, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.pad(np.where(depth > 0, 1 / depth, 0.0), 1, mode="reflect", reflect_type="odd")
    center = inverse[1:-1, 1:-1]
    bend_x = inverse[1:-1, :-2] - 2 * center + inverse[1:-1, 2:]
    bend_y = inverse[:-2, 1:-1] - 2 * center + inverse[2:, 1:-1]
    return (depth > 0) & (np.maximum(np.abs(bend_x), np.abs(bend_y)) * depth**2 > threshold)


def incidence(depth: Depth, k: Float[np.ndarray, "3 3"]) -> Depth:
    """Angle between each pixel's ray and the surface normal in the depth image, degrees; 0 for pixels without depth."""
    rays = pixel_rays(k, depth.shape[1], depth.shape[0])
    points = rays * depth[..., None]
    normals = np.cross(_tangent(points, axis=1), _tangent(points, axis=0))
    lengths = np.sqrt(np.sum(normals**2, axis=-1) * np.sum(rays**2, axis=-1))
    cosines = np.abs(np.sum(normals * rays, axis=-1)) / np.where(lengths > 0, lengths, 1)
    return np.where((depth > 0) & (lengths > 0), np.degrees(np.arccos(np.clip(cosines, 0, 1))), 0.0)


def luminance(rgb: UInt8[np.ndarray, "height width 3"]) -> Depth:
    """Linear luminance of an sRGB image, 0..1; used as reflectance, so that shadows count as dark too."""
    return LINEAR[rgb] @ LUMINANCE


def _tangent(points: Float[np.ndarray, "height width 3"], axis: int) -> Float[np.ndarray, "height width 3"]:
    """Difference to the next or from the previous pixel: to the one nearer in depth, which is on the same surface."""
    forward = np.diff(points, axis=axis)
    if not forward.size:
        return np.zeros_like(points)  # a single row or column has no slope
    first, last = np.take(forward, [0], axis), np.take(forward, [-1], axis)
    ahead, behind = np.concatenate([forward, last], axis), np.concatenate([first, forward], axis)
    return np.where((np.abs(ahead[..., 2]) <= np.abs(behind[..., 2]))[..., None], ahead, behind)


def _quantised(depth: Depth, step: float) -> Depth:
    if step == 0:
        return depth
    with np.errstate(divide="ignore"):
        return 1 / (np.maximum(np.rint(1 / (depth * step)), 1) * step)
