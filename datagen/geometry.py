"""Cameras, rigid poses and sRGB; the one place where conventions are turned into arithmetic.

World: right-handed, z up, metres. Camera: OpenCV (x right, y down, z forward). Image: pixel (0, 0) is the top left one,
its centre lies at (0.5, 0.5). Depth is planar: the camera's z, not the length of the ray. A pose `a_from_b` is a 4x4
matrix that takes points of frame b to frame a. Quaternions are (w, x, y, z).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float


def look_at(position: Float[np.ndarray, "3"], target: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """world_from_camera of a camera at `position` that looks at `target`, its image's top towards world +z.

    Raises:
        ValueError: the two coincide, or the line of sight is vertical, which leaves the roll undefined.
    """
    forward = target - position
    distance = np.sqrt(np.sum(forward * forward))
    if distance == 0:
        raise ValueError(f"The camera's position and target are both {position}; move one of them.")
    forward = forward / distance
    right = np.array([forward[1], -forward[0], 0.0])
    horizontal = np.sqrt(np.sum(right * right))
    if horizontal < 1e-9:
        raise ValueError(f"The camera at {position} looks straight up or down; move it or its target sideways.")
    right = right / horizontal
    pose = np.eye(4)
    pose[:3, 0] = right
    pose[:3, 1] = cross(forward, right)
    pose[:3, 2] = forward
    pose[:3, 3] = position
    return pose


def cross(a: Float[np.ndarray, "*batch 3"], b: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Cross product along the last axis: `np.cross` without its overhead for few vectors."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        product[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return product


def intrinsics(field_of_view: float, width: int, height: int) -> Float[np.ndarray, "3 3"]:
    """Camera matrix K in pixels of an ideal camera with square pixels and this horizontal field of view (radians)."""
    focal = 0.5 * width / np.tan(0.5 * field_of_view)
    return np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])


def invert_rigid(pose: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 4 4"]:
    """b_from_a of a rigid a_from_b, exact up to the rounding of one product."""
    inverse = np.zeros_like(pose)
    rotation = np.swapaxes(pose[..., :3, :3], -1, -2)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3] = -(rotation @ pose[..., :3, 3, None])[..., 0]
    inverse[..., 3, 3] = 1
    return inverse


def transform(
    a_from_b: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "*points 3"]
) -> Float[np.ndarray, "*points 3"]:
    """Transform points from frame b to frame a."""
    return points @ a_from_b[:3, :3].T + a_from_b[:3, 3]


def rotation_from_quaternion(quaternion_wxyz: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrix of a quaternion (w, x, y, z), which need not have unit length; in float64."""
    quaternion = np.asarray(quaternion_wxyz, np.float64)
    quaternion = quaternion / np.sqrt(np.sum(quaternion * quaternion, axis=-1, keepdims=True))
    w, x, y, z = (quaternion[..., axis] for axis in range(4))
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    rotation = np.empty((*quaternion.shape[:-1], 3, 3))
    for i, row in enumerate(rows):
        for j, value in enumerate(row):
            rotation[..., i, j] = value
    return rotation


def quaternion_from_rotation(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4"]:
    """Quaternion (w, x, y, z) with w >= 0 of a rotation matrix."""
    m = rotation
    # The largest of the four squared components is at least 1/4, so that dividing by it is safe.
    squares = 0.25 * np.array(
        [
            1 + m[0, 0] + m[1, 1] + m[2, 2],
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
        ]
    )
    products = 0.25 * np.array(
        [
            [0, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], 0, m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], 0, m[2, 1] + m[1, 2]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2], 0],
        ]
    )
    largest = int(np.argmax(squares))
    component = np.sqrt(squares[largest])
    quaternion = products[largest] / component
    quaternion[largest] = component
    return quaternion if quaternion[0] >= 0 else -quaternion


def rigid(
    position: Float[np.ndarray, "*batch 3"], quaternion_wxyz: Float[np.ndarray, "*batch 4"]
) -> Float[np.ndarray, "*batch 4 4"]:
    """world_from_object of an object at `position` (metres) with orientation `quaternion_wxyz`; in float64."""
    pose = np.zeros((*position.shape[:-1], 4, 4))
    pose[..., :3, :3] = rotation_from_quaternion(quaternion_wxyz)
    pose[..., :3, 3] = position
    pose[..., 3, 3] = 1
    return pose


def project(
    points: Float[np.ndarray, "*points 3"],
    k: Float[np.ndarray, "3 3"],
    world_from_camera: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "*points 2"], Float[np.ndarray, "*points"]]:
    """Pixel coordinates (x, y) and planar depth of world points; points behind the camera have negative depth."""
    local = transform(invert_rigid(world_from_camera), points)
    z = local[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = local[..., :2] / z[..., None] * np.array([k[0, 0], k[1, 1]]) + k[:2, 2]
    return pixels, z


def pixel_rays(k: Float[np.ndarray, "3 3"], width: int, height: int) -> Float[np.ndarray, "height width 3"]:
    """Directions through the pixel centres in the camera frame, scaled to z = 1: depth times ray is the point."""
    x = (np.arange(width) + 0.5 - k[0, 2]) / k[0, 0]
    y = (np.arange(height) + 0.5 - k[1, 2]) / k[1, 1]
    rays = np.ones((height, width, 3))
    rays[..., 0] = x
    rays[..., 1] = y[:, None]
    return rays


def unproject(
    depth: Float[np.ndarray, "height width"],
    k: Float[np.ndarray, "3 3"],
    world_from_camera: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "height width 3"]:
    """World points of a planar depth image in metres; pixels without return (depth 0) land on the camera's centre."""
    height, width = depth.shape
    return transform(world_from_camera, pixel_rays(k, width, height) * depth[..., None].astype(np.float64))


def linear(srgb: Sequence[float] | Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Linear light of sRGB values in 0..1 (IEC 61966-2-1)."""
    value = np.asarray(srgb, np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


LINEAR = linear(np.arange(256) / 255)
"""Linear light of each sRGB byte."""
