"""Rotations: an even grid, the 24 symmetries of a box, and distances.

The grid is the start of the paper's orientation search (section Object Location and Orientation Conditioned
Encoding): HEALPix directions times rotations about them (Yershova et al. 2010).
"""

import math
from functools import lru_cache
from itertools import permutations, product

import torch
from jaxtyping import Float
from torch import Tensor

_PLASTIC = 1.22074408460575947536
"""Root of x^4 = x + 1, whose powers give an evenly distributed sequence of points in a cube (Roberts 2018)."""


def healpix_directions(level: int) -> Float[Tensor, "direction 3"]:
    """Centres of the 12 * 4^level pixels of equal area on the sphere (Gorski et al. 2005), ring by ring."""
    side = 2**level
    return torch.cat([_ring(ring, side) for ring in range(1, 4 * side)]).float()


@lru_cache(maxsize=8)
def rotation_grid(level: int) -> Float[Tensor, "rotation 3 3"]:
    """Grid of 72 * 8^level rotations, each representing the same volume of SO(3) (Yershova et al. 2010).

    The z axis is rotated to every HEALPix direction, with 6 * 2^level rotations about it. The neighbours of a rotation
    are 60, 30, 15 degrees away at levels 0, 1, 2.
    """
    # Azimuth and polar angle of each direction, and rotations about it.
    z = healpix_directions(level).double()
    azimuth, polar = torch.atan2(z[:, 1], z[:, 0]), torch.acos(z[:, 2].clamp(-1, 1))
    turns = torch.arange(6 * 2**level, dtype=torch.float64) * (2 * math.pi / (6 * 2**level))
    tilted = _about(2, azimuth) @ _about(1, polar)
    return (tilted[:, None] @ _about(2, turns)[None]).flatten(0, 1).float()


@lru_cache(maxsize=1)
def box_rotations() -> Float[Tensor, "24 3 3"]:
    """Rotations that map a cube to itself, the identity first."""
    axes = torch.eye(3)
    signed = [
        axes[list(order)] * torch.tensor(signs)[:, None]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return torch.stack([matrix for matrix in signed if torch.linalg.det(matrix) > 0])


@lru_cache(maxsize=8)
def box_grid(level: int) -> Float[Tensor, "rotation 3 3"]:
    """Rotations of the grid that are at least as near to the identity as their 24 equivalents: a fundamental domain."""
    grid = rotation_grid(level)
    traces = torch.einsum("gij,eij->ge", grid, box_rotations())
    return grid[traces[:, 0] >= traces.amax(dim=1) - 1e-6]


def equivalents(rotation: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape 24 3 3"]:
    """Orientations of the same box with its axes permuted; the rotation itself comes first."""
    return rotation[..., None, :, :] @ box_rotations().to(rotation)


def geodesic_distance(a: Float[Tensor, "*shape 3 3"], b: Float[Tensor, "*shape 3 3"]) -> Float[Tensor, "*shape"]:
    """Angle between two rotations, radians (paper, eq. 5).

    The paper's arccos((tr(a b^-1) - 1) / 2) loses all digits near 0 and can leave its domain by rounding. This is the
    same angle from the chord |a - b| = 2 sqrt(2) sin(angle / 2).
    """
    chord = torch.linalg.matrix_norm(a - b)
    return 2 * torch.asin((chord / math.sqrt(8)).clamp(max=1))


def rotation_from_vector(vector: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3 3"]:
    """Rotation about a vector by its length in radians (Rodrigues), via the quaternion."""
    half = vector.norm(dim=-1, keepdim=True) / 2
    # sinc(x) = sin(pi x) / (pi x), which is 1 at 0.
    return rotation_from_quaternion(torch.cat([half.cos(), vector / 2 * torch.sinc(half / math.pi)], dim=-1))


def rotation_from_quaternion(wxyz: Float[Tensor, "*shape 4"]) -> Float[Tensor, "*shape 3 3"]:
    """Rotation of a quaternion of any length but 0."""
    w, x, y, z = (wxyz / wxyz.norm(dim=-1, keepdim=True)).unbind(dim=-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


@lru_cache(maxsize=64)
def small_rotations(count: int, angle: float) -> Float[Tensor, "count 3 3"]:
    """Fixed, evenly spread rotations by at most `angle` radians."""
    # Even in the ball: cube root of a radius, and a direction by height and azimuth.
    steps = torch.arange(1, count + 1, dtype=torch.float64)[:, None]
    radius, height, turn = (0.5 + steps / _PLASTIC ** torch.arange(1, 4)).frac().unbind(dim=1)
    z, azimuth = 2 * height - 1, 2 * math.pi * turn
    across = (1 - z * z).sqrt()
    directions = torch.stack([across * azimuth.cos(), across * azimuth.sin(), z], dim=1)
    return rotation_from_vector(angle * radius[:, None] ** (1 / 3) * directions).float()


def _ring(ring: int, side: int) -> Float[Tensor, "direction 3"]:
    """Pixel centres of one ring; rings grow from a pole to 4 * side pixels and shrink towards the other pole."""
    from_pole = min(ring, 4 * side - ring)
    if from_pole < side:
        count, shift, z = 4 * from_pole, 0.5, math.copysign(1 - from_pole**2 / (3 * side**2), 2 * side - ring)
    else:
        count, shift, z = 4 * side, 0.5 * ((ring - side + 1) % 2), (4 - 2 * ring / side) / 3
    azimuth = (torch.arange(count, dtype=torch.float64) + shift) * (2 * math.pi / count)
    across = math.sqrt(1 - z * z)
    return torch.stack([across * azimuth.cos(), across * azimuth.sin(), torch.full_like(azimuth, z)], dim=1)


def _about(axis: int, angle: Float[Tensor, "angle"]) -> Float[Tensor, "angle 3 3"]:
    vector = torch.zeros((len(angle), 3), dtype=angle.dtype)
    vector[:, axis] = angle
    return rotation_from_vector(vector)
