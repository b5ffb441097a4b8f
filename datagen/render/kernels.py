"""The rasteriser's inner loops, compiled by numba; plain arrays in, plain arrays out.

A *sample* is one of the 3x3 points of a pixel at which visibility is computed. The middle one is the pixel's centre; it
alone determines depth and id. A *light space* is an orthographic view along a direction L: texel coordinates u, v and
d = -p.L, the distance from the light in metres up to a constant.

All kernels are in one file because numba's cache does not notice changes of called functions in other files.

An image is made in these steps:
    place_vertices, project_vertices ..... object frame -> world -> homogeneous sample coordinates
    rasterise ............................ nearest triangle and 1/z of each sample
    light_vertices, rasterise_light ...... depth map as seen from the first light, for shadows
    shade, row by row:
        _collect ......................... samples to shade: one per pixel, more at edges
        _locate .......................... position, normal, texture and ambient occlusion of each sample
        _shadow .......................... share of the light's disc that each sample sees
        _reflect ......................... reflectance model, summed over the lights
        _blend ........................... weighted mean per pixel, sRGB
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

NEAR = 0.05
"""`renderer.NEAREST`: surfaces nearer to the camera than this are cut away, pixel by pixel, metres."""

SUB = 3
"""Samples per pixel along each axis."""

TILE = 8
"""Side length, in texels, of the tiles that store the least depth of a light-space map."""

TABLE = -1
NOTHING = -2
FAR = 1e9

CREASE = 0.96
"""Cosine between two triangles' normals below which the pixel they share is anti-aliased."""

AO_LENGTH = 0.02
"""Distance over which an object darkens the ambient light around its foot, metres."""

CONTACT_LENGTH = 0.005
"""Distance over which it does so where it touches the table, in rich images, metres."""

GLOSSY = 0.6
"""Roughness below which rich surfaces reflect the pattern of the table."""

MIRROR_STEP, MIRROR_GROWTH, MIRROR_STEPS = 0.004, 1.22, 13
"""Points of a ray at which it may meet a reflected object: metres to the first, growth of the steps, and number."""

SWEEP = 1.5
"""Width of the band beyond the table over which rich images fade to the backdrop, in halves of the table."""

PATTERNS = ("plain", "two-tone", "checker", "stripes", "noise", "wood", "dots", "image", "clouds")
"""Patterns by the number that kernels know them by; `clouds` is the `noise` of rich images."""
IMAGE = 7
"""Index of the pattern whose colours come from a mesh's `Skins`."""


def _vogel_disc(count: int) -> np.ndarray:
    turn = np.pi * (3 - np.sqrt(5))
    index = np.arange(count)
    radius = np.sqrt((index + 0.5) / count)
    return np.stack([radius * np.cos(turn * index), radius * np.sin(turn * index)], axis=1)


FINE_DISC, COARSE_DISC = _vogel_disc(32), _vogel_disc(16)
COARSE = 4.0
"""Largest penumbra radius, in texels, for which fewer samples suffice."""


def _srgb_table() -> np.ndarray:
    linear = (np.arange(16384) + 0.5) / 16384
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)


SRGB = _srgb_table()

kernel = njit(cache=True, error_model="numpy")
"""Compiles a function for calls from Python and from other kernels."""
inner = njit(cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)  # pyright: ignore[reportCallIssue]
"""Compiles a function for calls from other kernels only, which takes less time."""


def _windows() -> np.ndarray:
    """Windows of the room that rich surfaces reflect: centre, half width and half height as vectors, and radiance."""
    rows = []
    for azimuth, elevation, width, height, radiance in (
        (25, 40, 0.38, 0.3, 5.0),
        (150, 30, 0.5, 0.22, 3.0),
        (255, 50, 0.22, 0.36, 4.0),
    ):
        a, e = np.radians(azimuth), np.radians(elevation)
        center = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        side = np.array([-np.sin(a), np.cos(a), 0.0])
        rows.append([*center, *side / width, *np.cross(center, side) / height, radiance, width, height])
    return np.array(rows)


WINDOWS = _windows()


def _linear_table() -> np.ndarray:
    value = np.arange(256) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


LINEAR = _linear_table()

SKY_SCALE = 0.63
"""Factor that makes the mean of `_sky` one."""


class Skins(NamedTuple):
    """Textures and vertex colours of all objects; rows of faces are those of `Mesh`, unused ones being zero."""

    uv: np.ndarray
    colors: np.ndarray
    density: np.ndarray
    """Texels per metre at level 0."""
    texture: np.ndarray
    levels: np.ndarray
    """First level of each texture, and one row more for the end."""
    images: np.ndarray
    """First texel, width and height of each level."""
    texels: np.ndarray
    """sRGB of all texels of all levels."""


class Mesh(NamedTuple):
    """Concatenated meshes of all objects of a scene, each in its object frame."""

    vertices: np.ndarray
    faces: np.ndarray
    owners: np.ndarray
    """Object that each face belongs to."""
    normals: np.ndarray
    face_normals: np.ndarray


class LightMap(NamedTuple):
    """Depth map seen from a light; see `light_vertices` and `rasterise_light`."""

    texels: np.ndarray
    """Three planes: least d of faces towards the light, least d of faces away from it, and object of the former."""
    tiles: np.ndarray
    """Per block of texels: least d of its first plane; least d at which it blocks an object's own light; the object if
    it is the only one there, otherwise `NOTHING`."""
    used: np.ndarray
    """Whether a block has faces."""
    counts: np.ndarray
    """Number of blocks above and to the left of each that have faces."""
    frame: np.ndarray
    axes: np.ndarray


class Surroundings(NamedTuple):
    """Lights (direction, radiance, angular radius in each row) and colours, linear RGB."""

    lights: np.ndarray
    casts_shadow: bool
    ambient: np.ndarray
    ground: np.ndarray
    backdrop: np.ndarray
    occlusion: np.ndarray
    occlusion_frame: np.ndarray
    turn: np.ndarray
    """Cosine and sine of the room's angle about the vertical."""
    arriving: np.ndarray
    """Light that arrives on the open table, linear RGB."""
    below: np.ndarray
    """Texels of the `LightMap` behind `occlusion`, for reflections of other objects."""
    highest: float
    """Height of the highest point of all objects, metres."""


class Row(NamedTuple):
    """Scratch memory for the samples of one image row that are shaded."""

    kind: np.ndarray
    """Index of the triangle, or TABLE, or NOTHING."""
    owner: np.ndarray
    """Index of the object, or TABLE, or NOTHING."""
    pixel: np.ndarray
    share: np.ndarray
    """Share of the pixel's area that the sample stands for."""
    at: np.ndarray
    """Coordinates on the grid of samples (`SUB` per pixel), and depth if the sample shows the table."""
    point: np.ndarray
    normal: np.ndarray
    look: np.ndarray
    second: np.ndarray
    """Share of the second colour."""
    albedo: np.ndarray
    """Linear RGB where the pattern is `IMAGE`."""
    light: np.ndarray
    """Share of the first light that arrives; shares of the ambient light from above and from below that are blocked."""
    blur: np.ndarray
    color: np.ndarray
    total: np.ndarray
    mirrored: np.ndarray
    """Linear RGB of the table that each sample of a rich image reflects; negative if it is too rough to show it."""
    fade: np.ndarray
    """Share of the backdrop in the colour of each sample of a rich image."""


# --- Solid textures -----------------------------------------------------------------------------------------------


@inner
def _ramp(x):
    """Linear step from 0 to 1 around x = 0, one unit wide."""
    return min(max(0.5 + x, 0.0), 1.0)


@inner
def _square_wave(x, period, width):
    """+1 around multiples of the period, -1 between them, its edges smoothed over `width`."""
    s = x / period
    distance = (abs(s - math.floor(s) - 0.5) - 0.25) * period
    return 2 * _ramp(distance / width) - 1


@inner
def _hash(x, y, z):
    """Hash of a lattice point, 32 bits: multiply by primes, then mix the bits."""
    h = (x * 73856093) ^ (y * 19349663) ^ (z * 83492791)
    h = ((h ^ (h >> 13)) * 1540483477) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 668265263) & 0xFFFFFFFF
    return h ^ (h >> 13)


@inner
def _lattice(x, y, z):
    """Random value of a lattice point, 0..1."""
    return (_hash(x, y, z) & 0xFFFF) / 65535.0


@inner
def _slope(x, y, z, dx, dy, dz):
    """Value at an offset from a lattice point of the plane through 0 with the point's random slope."""
    h = _hash(x, y, z)
    return ((h & 1023) - 511.5) * dx + (((h >> 10) & 1023) - 511.5) * dy + (((h >> 20) & 1023) - 511.5) * dz


@inner
def _slopes(x, y, z, fx, fy, fz, sx, sy):
    a = _slope(x, y, z, fx, fy, fz) * (1 - sx) + _slope(x + 1, y, z, fx - 1, fy, fz) * sx
    b = _slope(x, y + 1, z, fx, fy - 1, fz) * (1 - sx) + _slope(x + 1, y + 1, z, fx - 1, fy - 1, fz) * sx
    return a * (1 - sy) + b * sy


@inner
def _fade(f):
    return f * f * f * (f * (6 * f - 15) + 10)


@inner
def _clouds(x, y, z):
    """Gradient noise (Perlin 1985) with the spread of `_noise` around 0.5; shows no squares of the lattice."""
    ix, iy, iz = math.floor(x), math.floor(y), math.floor(z)
    fx, fy, fz = x - ix, y - iy, z - iz
    sx, sy, sz = _fade(fx), _fade(fy), _fade(fz)
    jx, jy, jz = int(ix), int(iy), int(iz)
    value = _slopes(jx, jy, jz, fx, fy, fz, sx, sy)
    if sz > 0:
        value = value * (1 - sz) + _slopes(jx, jy, jz + 1, fx, fy, fz - 1, sx, sy) * sz
    return 0.5 + value / 450


@inner
def _noise_layer(x, y, z, fx, fy):
    a = _lattice(x, y, z) * (1 - fx) + _lattice(x + 1, y, z) * fx
    b = _lattice(x, y + 1, z) * (1 - fx) + _lattice(x + 1, y + 1, z) * fx
    return a * (1 - fy) + b * fy


@inner
def _noise(x, y, z):
    """Value noise on the integer lattice, 0..1."""
    ix, iy, iz = math.floor(x), math.floor(y), math.floor(z)
    fx, fy, fz = x - ix, y - iy, z - iz
    fx, fy, fz = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy), fz * fz * (3 - 2 * fz)
    jx, jy, jz = int(ix), int(iy), int(iz)
    value = _noise_layer(jx, jy, jz, fx, fy)
    if fz > 0:
        value = value * (1 - fz) + _noise_layer(jx, jy, jz + 1, fx, fy) * fz
    return value


@inner
def _wood(x, y, z, period, ax, ay, az):
    """Rings around the axis, wavering along it; the trunk's middle lies outside of most objects."""
    along = x * ax + y * ay + z * az
    rx, ry, rz = x - along * ax, y - along * ay, z - along * az
    scale = 1 / (2.5 * period)
    slow = 0.12 * along
    waver = _noise(scale * (rx + slow * ax), scale * (ry + slow * ay), scale * (rz + slow * az))
    s = math.sqrt(rx * rx + ry * ry + rz * rz) / period + 0.9 * waver
    t = s - math.floor(s)
    rise = t / 0.75 if t < 0.75 else (1 - t) / 0.25
    return rise * rise * (3 - 2 * rise)


@inner
def _dots(x, y, z, period, width):
    """Balls on a body-centred cubic lattice, so that no plane misses them all."""
    nearest = 1.0
    for shift in (0.0, 0.5):
        dx, dy, dz = x / period - shift, y / period - shift, z / period - shift
        dx, dy, dz = dx - math.floor(dx + 0.5), dy - math.floor(dy + 0.5), dz - math.floor(dz + 0.5)
        nearest = min(nearest, dx * dx + dy * dy + dz * dz)
    return _ramp((0.3 - math.sqrt(nearest)) * period / width)


@inner
def _texture(rich, pattern, period, axis, x, y, z, width):
    """Share of the second colour at a point of the object frame, averaged over about `width` metres."""
    ax, ay, az = axis
    # Numbers are indices into PATTERNS.
    if pattern == 0:
        return 0.0
    if pattern == 1:
        return _ramp((x * ax + y * ay + z * az) / width)
    if pattern == 2:
        product = _square_wave(x, period, width) * _square_wave(y, period, width) * _square_wave(z, period, width)
        return 0.5 - 0.5 * product
    if pattern == 3:
        return 0.5 - 0.5 * _square_wave(x * ax + y * ay + z * az, period, width)
    if pattern == 6:
        return _dots(x, y, z, period, width)
    if pattern == 5:
        value = _wood(x, y, z, period, ax, ay, az)
    elif rich is not None and pattern == 8:
        # The second layer is turned by atan(3/4), so that the axes of the lattices do not add up.
        scale = 1.5 / period
        value = 0.65 * _clouds(scale * x, scale * y, scale * z)
        value += 0.35 * _clouds(scale * (1.6 * x + 1.2 * y) + 17, scale * (1.6 * y - 1.2 * x) + 5, 2 * scale * z)
        value = _ramp(2.4 * (value - 0.5))
    else:
        scale = 2 / period
        value = 0.65 * _noise(scale * x, scale * y, scale * z)
        value += 0.35 * _noise(2.03 * scale * x + 17, 2.03 * scale * y + 5, 2.03 * scale * z)
        value = _ramp(2.4 * (value - 0.5))
    # Fade to the mean where the period falls below the width, so that far textures do not alias.
    fade = min(period / (2 * width), 1.0)
    return 0.5 + fade * (value - 0.5)


@kernel
def texture_weights(pattern, period, axis, points, width):
    """Share of the second colour at points of the object frame, averaged over about `width` metres."""
    weights = np.empty(len(points))
    for i in range(len(points)):
        weights[i] = _texture(True, pattern, period, axis, points[i, 0], points[i, 1], points[i, 2], width)
    return weights


@kernel
def toned(colors):
    """`_tone` of all values of an array, in place."""
    for i in range(colors.size):
        colors.flat[i] = _tone(colors.flat[i])
    return colors


def encoded(colors):
    """SRGB bytes of linear values."""
    return SRGB[np.clip((colors * len(SRGB)).astype(np.int64), 0, len(SRGB) - 1)]


# --- Textures of meshes -------------------------------------------------------------------------------------------


@inner
def _texel(skins, level, x, y, c):
    """Linear value of one channel of a texel; textures repeat."""
    width, height = skins.images[level, 1], skins.images[level, 2]
    return LINEAR[skins.texels[skins.images[level, 0] + (y % height) * width + x % width, c]]


@inner
def _bilinear(skins, level, u, v, c):
    x, y = u * skins.images[level, 1] - 0.5, v * skins.images[level, 2] - 0.5
    i, j = math.floor(x), math.floor(y)
    fx, fy = x - i, y - j
    top = _texel(skins, level, i, j, c) * (1 - fx) + _texel(skins, level, i + 1, j, c) * fx
    bottom = _texel(skins, level, i, j + 1, c) * (1 - fx) + _texel(skins, level, i + 1, j + 1, c) * fx
    return top * (1 - fy) + bottom * fy


@inner
def _bicubic(skins, level, u, v, c):
    """Cubic B-spline through 4x4 texels, which shows no texels however near they are."""
    x, y = u * skins.images[level, 1] - 0.5, v * skins.images[level, 2] - 0.5
    i, j = math.floor(x), math.floor(y)
    value = 0.0
    for dy in range(-1, 3):
        for dx in range(-1, 3):
            value += _spline(x - i - dx) * _spline(y - j - dy) * _texel(skins, level, i + dx, j + dy, c)
    return value


@inner
def _spline(t):
    t = abs(t)
    return (4 - 6 * t * t + 3 * t * t * t) / 6 if t < 1 else (2 - t) ** 3 / 6


@kernel
def _skin(skins, face, a, b, c, width, rich, albedo):
    """Linear RGB of a face at barycentric weights, averaged over about `width` metres (trilinear mipmapping)."""
    uv, colors, texture = skins.uv, skins.colors, skins.texture[face]
    u = a * uv[face, 0, 0] + b * uv[face, 1, 0] + c * uv[face, 2, 0]
    v = a * uv[face, 0, 1] + b * uv[face, 1, 1] + c * uv[face, 2, 1]
    first, last = skins.levels[texture], skins.levels[texture + 1] - 1
    fine = min(max(math.log2(max(skins.density[face] * width, 1e-6)), 0.0), float(last - first))
    level = min(first + int(fine), last)
    share = fine - int(fine)
    for k in range(3):
        value = _bicubic(skins, level, u, v, k) if rich and fine == 0 else _bilinear(skins, level, u, v, k)
        if share > 0 and level < last:
            value = value * (1 - share) + _bilinear(skins, level + 1, u, v, k) * share
        albedo[k] = value * (a * colors[face, 0, k] + b * colors[face, 1, k] + c * colors[face, 2, k])


# --- Vertices -----------------------------------------------------------------------------------------------------


@kernel
def place_vertices(vertices, vertex_start, poses, world):
    """Transform vertices from the object frames to the world: p' = R p + t."""
    for o in range(len(poses)):
        for i in range(vertex_start[o], vertex_start[o + 1]):
            x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
            for r in range(3):
                world[i, r] = poses[o, r, 0] * x + poses[o, r, 1] * y + poses[o, r, 2] * z + poses[o, r, 3]


@kernel
def project_vertices(world, samples_from_world, homogeneous, screen):
    """Project world points to homogeneous sample coordinates (x z, y z, z), and divide those before the camera by z."""
    m = samples_from_world
    for i in range(len(world)):
        x, y, z = world[i, 0], world[i, 1], world[i, 2]
        for r in range(3):
            homogeneous[i, r] = m[r, 0] * x + m[r, 1] * y + m[r, 2] * z + m[r, 3]
        w = homogeneous[i, 2]
        if w > NEAR:
            screen[i, 0] = homogeneous[i, 0] / w
            screen[i, 1] = homogeneous[i, 1] / w


# --- Visibility ---------------------------------------------------------------------------------------------------


@kernel
def rasterise(world, homogeneous, screen, faces, face_start, view, triangle, inverse_depth, stamp, amodal):
    """Nearest triangle of every sample, by homogeneous edge functions, which need no clipping.

    With q the homogeneous corners and s a sample, e_i = s . (q_j x q_k) tells the side of an edge and sum(e) / det(q)
    is 1/z (Olano and Greer, Triangle scan conversion using 2D homogeneous coordinates, 1997). The edge functions of two
    triangles along a shared edge are exact negatives, so that no sample falls between them.
    """
    height, width = triangle.shape
    side = 1.0 if view[2, 3] > 0 else -1.0
    for o in range(len(face_start) - 1):
        for f in range(face_start[o], face_start[o + 1]):
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            # Bounding box of the samples to test: of the projected corners if all are in front, otherwise the image.
            zi, zj, zk = homogeneous[i, 2], homogeneous[j, 2], homogeneous[k, 2]
            if zi > NEAR and zj > NEAR and zk > NEAR:
                xi, xj, xk = screen[i, 0], screen[j, 0], screen[k, 0]
                yi, yj, yk = screen[i, 1], screen[j, 1], screen[k, 1]
                if (xj - xi) * (yk - yi) - (yj - yi) * (xk - xi) >= 0:
                    continue
                x0 = max(math.ceil(min(xi, min(xj, xk)) - 0.5 - 1e-9), 0.0)
                x1 = min(math.floor(max(xi, max(xj, xk)) - 0.5 + 1e-9), width - 1.0)
                y0 = max(math.ceil(min(yi, min(yj, yk)) - 0.5 - 1e-9), 0.0)
                y1 = min(math.floor(max(yi, max(yj, yk)) - 0.5 + 1e-9), height - 1.0)
                if x0 > x1 or y0 > y1:
                    continue
            elif zi > NEAR or zj > NEAR or zk > NEAR:
                x0, x1, y0, y1 = 0.0, width - 1.0, 0.0, height - 1.0
            else:
                continue
            # Coefficients of the edge functions, the cross products q_j x q_k, q_k x q_i and q_i x q_j.
            qix, qiy = homogeneous[i, 0], homogeneous[i, 1]
            qjx, qjy = homogeneous[j, 0], homogeneous[j, 1]
            qkx, qky = homogeneous[k, 0], homogeneous[k, 1]
            ax, ay, az = qjy * zk - zj * qky, zj * qkx - qjx * zk, qjx * qky - qjy * qkx
            bx, by, bz = qky * zi - zk * qiy, zk * qix - qkx * zi, qkx * qiy - qky * qix
            cx, cy, cz = qiy * zj - zi * qjy, zi * qjx - qix * zj, qix * qjy - qiy * qjx
            det = qix * ax + qiy * ay + zi * az
            if det >= 0:  # seen from behind
                continue
            scale = 1 / det
            sinks = min(side * world[i, 2], min(side * world[j, 2], side * world[k, 2])) < 0
            for y in range(int(y0), int(y1) + 1):
                sy = y + 0.5
                a0, b0, c0 = ay * sy + az, by * sy + bz, cy * sy + cz
                middle = y % SUB == SUB // 2
                for x in range(int(x0), int(x1) + 1):
                    sx = x + 0.5
                    a, b, c = ax * sx + a0, bx * sx + b0, cx * sx + c0
                    if a > 0 or b > 0 or c > 0:  # outside the triangle
                        continue
                    inverse = (a + b + c) * scale
                    if inverse <= 0 or inverse * NEAR > 1:
                        continue
                    # Count the object's pixels as if nothing hid it, each pixel once.
                    if middle and x % SUB == SUB // 2 and stamp[y // SUB, x // SUB] != o:
                        stamp[y // SUB, x // SUB] = o
                        amodal[o] += 1
                    # Depth test, against other triangles and against the table.
                    if inverse > inverse_depth[y, x] and not (sinks and _behind_table(view, sx, sy, inverse)):
                        inverse_depth[y, x] = inverse
                        triangle[y, x] = f


@inner
def _behind_table(view, sx, sy, inverse):
    """Whether a sample's ray meets the table at an inverse depth above `inverse`."""
    nearer = -(view[2, 0] * sx + view[2, 1] * sy + view[2, 2]) / view[2, 3]
    if not nearer > inverse:
        return False
    x = view[0, 3] + (view[0, 0] * sx + view[0, 1] * sy + view[0, 2]) / nearer
    y = view[1, 3] + (view[1, 0] * sx + view[1, 1] * sy + view[1, 2]) / nearer
    return abs(x) <= view[3, 0] and abs(y) <= view[3, 0]


# --- Light-space maps ---------------------------------------------------------------------------------------------


@kernel
def light_vertices(world, axes, size, margin, light, frame):
    """Transform world points to a light space whose map of `size` texels holds them all with a margin in metres.

    Writes `frame` = (u of texel 0, v of texel 0, texels per metre, least d).
    """
    # Light-space coordinates in metres, and their bounds.
    low_u, low_v, low_d = FAR, FAR, FAR
    high_u, high_v = -FAR, -FAR
    for i in range(len(world)):
        x, y, z = world[i, 0], world[i, 1], world[i, 2]
        u = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z
        v = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z
        d = -(axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z)
        light[i, 0], light[i, 1], light[i, 2] = u, v, d
        low_u, high_u = min(low_u, u), max(high_u, u)
        low_v, high_v = min(low_v, v), max(high_v, v)
        low_d = min(low_d, d)
    # Square map around the bounds; metres to texels.
    scale = size / (max(high_u - low_u, high_v - low_v) + 2 * margin)
    frame[0], frame[1], frame[2], frame[3] = low_u - margin, low_v - margin, scale, low_d
    for i in range(len(world)):
        light[i, 0] = (light[i, 0] - frame[0]) * scale
        light[i, 1] = (light[i, 1] - frame[1]) * scale


@kernel
def rasterise_light(light, faces, face_start, map):
    """Fill a light's map; see `LightMap`."""
    front, back, owner = map.texels[0], map.texels[1], map.texels[2]
    tiles, used = map.tiles, map.used
    tile = len(front) // len(tiles)
    # Clear the tiles that the former map used.
    for y in range(len(tiles)):
        for x in range(len(tiles)):
            if used[y, x]:
                used[y, x] = False
                tiles[y, x, 0] = FAR
                for j in range(tile * y, tile * y + tile):
                    for i in range(tile * x, tile * x + tile):
                        front[j, i] = back[j, i] = owner[j, i] = FAR
    # Draw all triangles: nearest fronts with their owners, and nearest backs.
    for o in range(len(face_start) - 1):
        for f in range(face_start[o], face_start[o + 1]):
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            xi, xj, xk = light[i, 0], light[j, 0], light[k, 0]
            yi, yj, yk = light[i, 1], light[j, 1], light[k, 1]
            x0, x1 = int(min(xi, min(xj, xk)) + 0.5), int(max(xi, max(xj, xk)) + 0.5) - 1
            y0, y1 = int(min(yi, min(yj, yk)) + 0.5), int(max(yi, max(yj, yk)) + 0.5) - 1
            if x0 > x1 or y0 > y1:
                continue
            area = (xj - xi) * (yk - yi) - (yj - yi) * (xk - xi)
            if area == 0:
                continue
            for y in range(y0 // tile, y1 // tile + 1):
                for x in range(x0 // tile, x1 // tile + 1):
                    used[y, x] = True
            # The distance d is linear over the triangle; its gradient follows from the corners.
            di, dj, dk = light[i, 2], light[j, 2], light[k, 2]
            inverse = 1 / area
            du = ((dj - di) * (yk - yi) - (dk - di) * (yj - yi)) * inverse
            dv = ((dk - di) * (xj - xi) - (dj - di) * (xk - xi)) * inverse
            # Edge functions, which are 0 or more inside, and their steps from texel to texel.
            facing = area > 0
            side = 1.0 if facing else -1.0
            ax, bx, cx = side * (yj - yk), side * (yk - yi), side * (yi - yj)
            ay, by, cy = side * (xk - xj), side * (xi - xk), side * (xj - xi)
            px = x0 + 0.5
            for y in range(y0, y1 + 1):
                py = y + 0.5
                a = ay * (py - yj) + ax * (px - xj)
                b = by * (py - yk) + bx * (px - xk)
                c = cy * (py - yi) + cx * (px - xi)
                d = di + du * (px - xi) + dv * (py - yi)
                entered = False
                for x in range(x0, x1 + 1):
                    if a >= 0 and b >= 0 and c >= 0:
                        entered = True
                        if not facing:
                            back[y, x] = min(back[y, x], d)
                        elif d < front[y, x]:
                            front[y, x] = d
                            owner[y, x] = o
                    elif entered:
                        break
                    a, b, c, d = a + ax, b + bx, c + cx, d + du
    for y in range(len(tiles)):
        for x in range(len(tiles)):
            if not used[y, x]:
                continue
            # Least depth of the tile, depth from which an object shades itself, and the only owner if there is one.
            least, own, first, alone = FAR, FAR, FAR, True
            for j in range(tile * y, tile * y + tile):
                for i in range(tile * x, tile * x + tile):
                    least = min(least, front[j, i])
                    own = min(own, max(front[j, i], back[j, i]))
                    if owner[j, i] < FAR:
                        first = owner[j, i] if first == FAR else first
                        alone &= owner[j, i] == first
            tiles[y, x, 0], tiles[y, x, 1], tiles[y, x, 2] = least, own, first if alone else NOTHING
    # Numbers of used tiles above and left of each corner, for sums over rectangles.
    counts = map.counts
    for y in range(len(tiles)):
        row = 0
        for x in range(len(tiles)):
            row += used[y, x]
            counts[y + 1, x + 1] = counts[y, x + 1] + row


@inner
def _blocks(front, back, owner, y, x, receiver, d):
    """Whether a texel's surface lies between the light and a receiver at `d`.

    An object's lit side is compared with its own far side, which leaves no room for shadow acne and needs no bias. The
    receiver is an object, or None for the table, for which numba compiles shorter code.
    """
    if receiver is None:
        return 1.0 * (front[y, x] <= d)
    # Bitwise, for a processor guesses badly here.
    return 1.0 * ((front[y, x] <= d) & ((owner[y, x] != receiver) | (back[y, x] < d - 1e-4)))


@inner
def _may_block(tiles, counts, tile, u, v, d, du, dv, reach, receiver):
    """Range of rows and of columns of texels within `reach` that may lie between the light and the receiver's plane."""
    last = len(tiles) - 1
    x0, x1 = max(int((u - reach) / tile), 0), min(int((u + reach) / tile), last)
    y0, y1 = max(int((v - reach) / tile), 0), min(int((v + reach) / tile), last)
    top, bottom, left, right = last + 1, -1, last + 1, -1
    if counts[y1 + 1, x1 + 1] - counts[y0, x1 + 1] - counts[y1 + 1, x0] + counts[y0, x0] == 0:
        return 0, -1, 0, -1
    for y in range(y0, y1 + 1):
        # The outer tiles stand for all that lies beyond the map.
        low = max(tile * y - v, -reach) if y > 0 else -reach
        high = min(tile * (y + 1) - v, reach) if y < last else reach
        across = d + max(dv * low, dv * high) + 1e-6
        for x in range(x0, x1 + 1):
            if tiles[y, x, 0] >= FAR:
                continue
            low = max(tile * x - u, -reach) if x > 0 else -reach
            high = min(tile * (x + 1) - u, reach) if x < last else reach
            if tiles[y, x, 1 if tiles[y, x, 2] == receiver else 0] < across + max(du * low, du * high):
                top, bottom, left, right = min(top, y), max(bottom, y), min(left, x), max(right, x)
    return tile * top, tile * bottom + tile - 1, tile * left, tile * right + tile - 1


@inner
def _blockers(front, back, owner, box, u, v, d, du, dv, reach, receiver):
    """Share of blockers on a grid of texels within `reach`, and their mean distance from the receiver's plane.

    Texels outside of `box`, the ranges of rows and columns, are known to block nothing.
    """
    last = len(front) - 1
    half = 2 if reach < COARSE else 3
    count, total, step = 0.0, 0.0, reach / half
    for j in range(-half, half + 1):
        y = min(max(int(v + j * step), 0), last)
        if y < box[0] or y > box[1]:
            continue
        for i in range(-half, half + 1):
            x = min(max(int(u + i * step), 0), last)
            if x < box[2] or x > box[3]:
                continue
            at = d + (du * i + dv * j) * step
            hit = _blocks(front, back, owner, y, x, receiver, at)
            count += hit
            total += hit * (at - front[y, x])
    return count / (2 * half + 1) ** 2, total / max(count, 1.0)


@inner
def _dark_share(front, back, owner, disc, u, v, d, du, dv, radius, receiver):
    """Share of a disc of texels that blocks the light, each point of it interpolated between four texels."""
    last = len(front) - 2
    dark = 0.0
    for i in range(len(disc)):
        su, sv = disc[i, 0] * radius, disc[i, 1] * radius
        at = d + du * su + dv * sv
        fu, fv = min(max(u + su - 0.5, 0.0), last), min(max(v + sv - 0.5, 0.0), last)
        x, y = int(fu), int(fv)
        fu, fv = fu - x, fv - y
        # Bilinear interpolation of the test at the four texels around the point.
        a = _blocks(front, back, owner, y, x, receiver, at)
        b = _blocks(front, back, owner, y, x + 1, receiver, at)
        top = a + fu * (b - a)
        a = _blocks(front, back, owner, y + 1, x, receiver, at)
        b = _blocks(front, back, owner, y + 1, x + 1, receiver, at)
        dark += top + fv * (a + fu * (b - a) - top)
    return dark / len(disc)


@inner
def _lit_share(front, back, owner, box, u, v, d, du, dv, reach, spread, blur, scale, receiver):
    """Share of the light that arrives: the mean distance of the blockers gives the radius over which it is averaged."""
    found, height = _blockers(front, back, owner, box, u, v, d, du, dv, reach, receiver)
    if found == 0 or found == 1:
        return 1 - found
    radius = (spread * max(height, 0.0) + blur) * scale
    disc = COARSE_DISC if radius < COARSE else FINE_DISC
    return 1 - _dark_share(front, back, owner, disc, u, v, d, du, dv, radius, receiver)


# --- The room of rich images --------------------------------------------------------------------------------------


@inner
def _pane(a, size, blur):
    """Share of a window that is seen at `a` half sizes from its middle, where a bar divides it."""
    width = blur / size
    bar = min(0.08 / width, 1.0) * _ramp((0.04 - abs(a)) / width)
    return _ramp((1 - abs(a)) / width) * (1 - bar)


@inner
def _sky(turn, x, y, z, blur):
    """Radiance of the room above the table in a direction, averaged over about `blur` radians.

    It is relative to the ambient light: over the hemisphere its mean, weighted with the cosine, is one.
    """
    x, y = turn[0] * x + turn[1] * y, turn[0] * y - turn[1] * x
    wall = _ramp((z - 0.1) / (0.06 + blur))
    ceiling = _ramp((z - 0.8) / (0.06 + blur))
    value = 0.35 + (0.35 + 0.25 * x) * wall + 0.25 * ceiling
    for i in range(len(WINDOWS)):
        w = WINDOWS[i]
        along = w[0] * x + w[1] * y + w[2] * z
        if along > 0.2:
            a, b = (w[3] * x + w[4] * y + w[5] * z) / along, (w[6] * x + w[7] * y + w[8] * z) / along
            if (abs(a) - 1) * w[10] < 0.5 * blur and (abs(b) - 1) * w[11] < 0.5 * blur:
                value += w[9] * _pane(a, w[10], blur) * _pane(b, w[11], blur)
    return SKY_SCALE * value


@kernel
def sky(turn, directions, blur):
    """`_sky` for unit vectors in rows."""
    values = np.empty(len(directions))
    for i in range(len(directions)):
        values[i] = _sky(turn, directions[i, 0], directions[i, 1], directions[i, 2], blur)
    return values


@inner
def _mirror(s, materials, row, q, n, e, roughness):
    """Compute the colour of the table or of another object where the mirror direction of a sample meets it.

    Objects are columns between the heights that `below` holds.
    """
    row.mirrored[q, 0] = -1.0
    if roughness >= GLOSSY:
        return
    toward = 2 * (n[0] * e[0] + n[1] * e[1] + n[2] * e[2])
    x, y, z = row.point[q, 0], row.point[q, 1], row.point[q, 2]
    rx, ry, rz = toward * n[0] - e[0], toward * n[1] - e[1], toward * n[2] - e[2]
    # March along the mirrored ray, in growing steps, down to the ground, through the map of the objects' heights.
    least_x, least_y, scale = s.occlusion_frame[0], s.occlusion_frame[1], s.occlusion_frame[2]
    own, size = row.owner[q], len(s.occlusion)
    ground = -max(z, 0.0) / rz if rz < -0.02 else FAR
    t, step = 0.0, MIRROR_STEP
    for _ in range(MIRROR_STEPS):
        t, step = min(t + step, ground), step * MIRROR_GROWTH
        h = z + t * rz
        u, v = int((x + t * rx - least_x) * scale), int((-y - t * ry - least_y) * scale)
        if h > s.highest or u < 0 or v < 0 or u >= size or v >= size:
            break
        low, top, o = s.below[0, v, u], s.below[1, v, u], int(s.below[2, v, u])
        if top < FAR and o != own and h <= top and (h >= low or (t == ground and low < 0.01)):
            shade = 0.3 + 0.4 * h / top
            for c in range(3):
                row.mirrored[q, c] = shade * s.arriving[c] * materials[o, c]
            return
        if t == ground:
            break
    # Nothing was met: the table, if the ray goes down.
    if ground == FAR:
        return
    t = ground
    x, y = x + t * rx, y + t * ry
    m = materials[len(materials) - 1]
    width = row.blur[q] + t * (0.05 + roughness * roughness)
    second = _texture(True, int(m[6]), m[7], (m[8], m[9], m[10]), x, y, 0.0, width)
    open_share = 1 - _occlusion_at(s.occlusion, s.occlusion_frame, x, y)
    for c in range(3):
        row.mirrored[q, c] = open_share * s.arriving[c] * (m[c] + second * (m[3 + c] - m[c]))


# --- Ambient occlusion ----------------------------------------------------------------------------------------------


@kernel
def occlusion_map(texels, scale, length, occlusion):
    """Darkness of the ambient light on the table, from a light space that looks up from below (d is height).

    It falls off over `length` metres, in height as along the table.
    """
    size = len(occlusion)
    for y in range(size):
        for x in range(size):
            low, high = texels[0, y, x], texels[1, y, x]
            if low >= FAR:
                occlusion[y, x] = 0
                continue
            height = max(low, 0.0)
            thickness = min(max(high - low, 0.0), 1.0)
            # Objects that are near the table or thick take the most light.
            fade = length / (length + height)
            occlusion[y, x] = fade * fade * thickness / (thickness + 0.5 * length)
    # Blur, as light from everywhere has no sharp shadow.
    a = 1 / (1 + 0.7 * length * scale)
    for _ in range(2):
        _smooth_columns(occlusion, a)
        _smooth_columns(occlusion.T, a)


@inner
def _smooth_columns(image, a):
    """Two-sided exponential filter down each column."""
    for y in range(1, len(image)):
        for x in range(image.shape[1]):
            image[y, x] = image[y - 1, x] + a * (image[y, x] - image[y - 1, x])
    for y in range(len(image) - 2, -1, -1):
        for x in range(image.shape[1]):
            image[y, x] = image[y + 1, x] + a * (image[y, x] - image[y + 1, x])


@inner
def _occlusion_at(occlusion, frame, x, y):
    u, v = (x - frame[0]) * frame[2] - 0.5, (-y - frame[1]) * frame[2] - 0.5
    size = len(occlusion)
    if u < 0 or v < 0 or u >= size - 1 or v >= size - 1:
        return 0.0
    i, j = int(u), int(v)
    fu, fv = u - i, v - j
    top = occlusion[j, i] * (1 - fu) + occlusion[j, i + 1] * fu
    bottom = occlusion[j + 1, i] * (1 - fu) + occlusion[j + 1, i + 1] * fu
    return top * (1 - fv) + bottom * fv


# --- Shading --------------------------------------------------------------------------------------------------------


@inner
def _unit(x, y, z):
    """Normalise a vector."""
    inverse = 1 / math.sqrt(x * x + y * y + z * z)
    return x * inverse, y * inverse, z * inverse


@inner
def _tone(x):
    """Identity up to 0.6, then a shoulder that approaches 1."""
    if x <= 0.6:
        return x
    excess = (x - 0.6) / 0.4
    return 0.6 + 0.4 * excess / (1 + excess)


@inner
def _fifth(x):
    return x * x * x * x * x


@inner
def _highlight(light, radius, facing, toward, n, e, roughness):
    """GGX lobe D G / (4 (n.l) (n.e)) of one light, and Schlick's Fresnel weight (1 - e.h)^5.

    Walter et al., Microfacet models for refraction through rough surfaces, 2007; G is Schlick's approximation of
    Smith's shadowing term. The light's angular radius widens the lobe.
    """
    h = _unit(light[0] + e[0], light[1] + e[1], light[2] + e[2])
    nh = n[0] * h[0] + n[1] * h[1] + n[2] * h[2]
    a = max(roughness * roughness, 0.01) + 0.5 * radius
    k = 0.5 * a
    spread = nh * nh * (a * a - 1) + 1
    smith = (facing * (1 - k) + k) * (toward * (1 - k) + k)
    grazing = _fifth(1 - max(e[0] * h[0] + e[1] * h[1] + e[2] * h[2], 0.0))
    return 0.25 * a * a / (spread * spread * smith), grazing


@inner
def _reflect(row, count, s, rich, materials):
    """Linear RGB, after the tone curve, that each sample sends along its `look`, the unit vector towards the camera.

    Lambert's law for dielectrics, highlights of the lights, and a reflection of the surroundings.
    """
    normal, look, light_share, colors = row.normal, row.look, row.light, row.color
    owner, lights, ambient, ground, backdrop = row.owner, s.lights, s.ambient, s.ground, s.backdrop
    for q in range(count):
        o = owner[q]
        if o == NOTHING:
            colors[q, 0], colors[q, 1], colors[q, 2] = backdrop[0], backdrop[1], backdrop[2]
            continue
        n = (normal[q, 0], normal[q, 1], normal[q, 2])
        e = (look[q, 0], look[q, 1], look[q, 2])
        # Ambient light: a sky above and the table's reflection below, mixed by the normal's height.
        roughness, metalness = materials[o, 11], materials[o, 12]
        above, below = 1 - light_share[q, 1], 1 - light_share[q, 2]
        toward = max(n[0] * e[0] + n[1] * e[1] + n[2] * e[2], 1e-3)
        upper, lower = (0.5 + 0.5 * n[2]) * above, (0.5 - 0.5 * n[2]) * below
        diffuse_r = upper * ambient[0] + lower * ground[0]
        diffuse_g = upper * ambient[1] + lower * ground[1]
        diffuse_b = upper * ambient[2] + lower * ground[2]
        # Mirror direction r, and the surroundings that it shows: a brighter horizon, and the table.
        r = (2 * toward * n[0] - e[0], 2 * toward * n[1] - e[1], 2 * toward * n[2] - e[2])
        share = _ramp(0.5 * r[2] / (0.04 + 0.8 * roughness))
        rise = 1 - max(r[2], 0.0)
        sky = share * above * (1.5 + 1.5 * rise * rise)
        # Straight down, a mirror sees the shade of the object itself.
        earth = (1 - share) * below * above * (0.8 - 0.5 * max(-r[2], 0.0))
        earth_r, earth_g, earth_b = ground[0], ground[1], ground[2]
        if rich is not None:
            sky = share * above
            if roughness < GLOSSY:
                sky *= _sky(s.turn, r[0], r[1], max(r[2], 0.0), 0.03 + 1.2 * roughness * roughness)
            if row.mirrored[q, 0] >= 0:
                earth, sky = (1 - share, sky) if r[2] < 0 else (1.0, 0.0)
                earth_r, earth_g, earth_b = row.mirrored[q, 0], row.mirrored[q, 1], row.mirrored[q, 2]
        base_r = sky * ambient[0] + earth * earth_r
        base_g = sky * ambient[1] + earth * earth_g
        base_b = sky * ambient[2] + earth * earth_b
        # Every light is also a square panel that glossy surfaces mirror; Schlick's rim brightens grazing views.
        panel_size, panel_scale = 1 / (0.06 + 0.5 * roughness), 0.5 * (1 - roughness) * share * above
        if rich is not None:  # its windows take the panels' place
            panel_scale = 0.0
        rim = _fifth(1 - toward) * (1 - roughness)
        edge_r, edge_g, edge_b = rim * base_r, rim * base_g, rim * base_b
        for i in range(len(lights)):
            light = (lights[i, 0], lights[i, 1], lights[i, 2])
            red, green, blue = lights[i, 3], lights[i, 4], lights[i, 5]
            panel = panel_scale * _ramp((r[0] * light[0] + r[1] * light[1] + r[2] * light[2] - 0.9) * panel_size)
            facing = n[0] * light[0] + n[1] * light[1] + n[2] * light[2]
            arriving = max(facing, 0.0) * (light_share[q, 0] if i == 0 else (1.0 if rich is None else above))
            glow, rim = 0.0, 0.0
            # The other lights are large and faint; they show as panels alone.
            if i == 0 and arriving > 0:
                lobe, grazing = _highlight(light, lights[i, 6], facing, toward, n, e, roughness)
                glow, rim = arriving * lobe * (1 - grazing), arriving * lobe * grazing
            glow += panel
            diffuse_r, diffuse_g, diffuse_b = (
                diffuse_r + arriving * red,
                diffuse_g + arriving * green,
                diffuse_b + arriving * blue,
            )
            base_r, base_g, base_b = base_r + glow * red, base_g + glow * green, base_b + glow * blue
            edge_r, edge_g, edge_b = edge_r + rim * red, edge_g + rim * green, edge_b + rim * blue
        # Metals have no diffuse part and colour their reflection; dielectrics reflect 4 %, uncoloured.
        second = row.second[q]
        matte, plain = 1 - metalness, 0.04 * (1 - metalness)
        for c in range(3):
            albedo = materials[o, c] + second * (materials[o, 3 + c] - materials[o, c])
            if materials[o, 6] == IMAGE:
                albedo = row.albedo[q, c]
            diffuse = diffuse_r if c == 0 else (diffuse_g if c == 1 else diffuse_b)
            base = base_r if c == 0 else (base_g if c == 1 else base_b)
            edge = edge_r if c == 0 else (edge_g if c == 1 else edge_b)
            colors[q, c] = _tone(matte * albedo * diffuse + (plain + metalness * albedo) * base + edge)
        if rich is not None and row.fade[q] > 0:
            for c in range(3):
                colors[q, c] += row.fade[q] * (backdrop[c] - colors[q, c])


@inner
def _world_ray(view, sx, sy):
    return (
        view[0, 0] * sx + view[0, 1] * sy + view[0, 2],
        view[1, 0] * sx + view[1, 1] * sy + view[1, 2],
        view[2, 0] * sx + view[2, 1] * sy + view[2, 2],
    )


@inner
def _table_hit(view, sx, sy):
    """Depth at which a sample's ray meets the table, 0 where it does not; whether its edge is within a pixel."""
    ray = _world_ray(view, sx, sy)
    t = -view[2, 3] / ray[2]
    if not t > NEAR:
        return 0.0, abs(ray[2]) < 2 * view[3, 1]
    x, y = view[0, 3] + t * ray[0], view[1, 3] + t * ray[1]
    beyond = max(abs(x), abs(y)) - view[3, 0]
    footprint = view[3, 1] * t * (ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]) / abs(ray[2])
    return t if beyond <= 0 else 0.0, abs(beyond) < footprint


@inner
def _weights(q, i, j, k, sx, sy):
    """Perspective-correct barycentric weights of a sample and its depth; see `rasterise`."""
    qix, qiy, zi = q[i, 0], q[i, 1], q[i, 2]
    qjx, qjy, zj = q[j, 0], q[j, 1], q[j, 2]
    qkx, qky, zk = q[k, 0], q[k, 1], q[k, 2]
    ax, ay, az = qjy * zk - zj * qky, zj * qkx - qjx * zk, qjx * qky - qjy * qkx
    a = ax * sx + ay * sy + az
    b = (qky * zi - zk * qiy) * sx + (zk * qix - qkx * zi) * sy + qkx * qiy - qky * qix
    c = (qiy * zj - zi * qjy) * sx + (zi * qjx - qix * zj) * sy + qix * qjy - qiy * qjx
    total = a + b + c
    return a / total, b / total, c / total, (qix * ax + qiy * ay + zi * az) / total


@inner
def _smooth(owners, n, face, other):
    """Whether two triangles belong to one smooth stretch of surface."""
    if owners[face] != owners[other]:
        return False
    return n[face, 0] * n[other, 0] + n[face, 1] * n[other, 1] + n[face, 2] * n[other, 2] > CREASE


@inner
def _single(triangle, x, y, face):
    """Whether all samples of a pixel see the same triangle, or none."""
    for j in range(SUB * y, SUB * y + SUB):
        for i in range(SUB * x, SUB * x + SUB):
            if triangle[j, i] != face:
                return False
    return True


@inner
def _collect(view, mesh, q, triangle, y, row, depth, segmentation):
    """Collect the samples of image row `y` to shade: one per pixel, or one per surface if several meet there."""
    faces, owners, normals = mesh.faces, mesh.owners, mesh.face_normals
    kind, share, pixel, at = row.kind, row.share, row.pixel, row.at
    count = 0
    for x in range(depth.shape[1]):
        # The pixel's centre: depth and id.
        cx, cy = SUB * x + 0.5 * SUB, SUB * y + 0.5 * SUB
        face = triangle[SUB * y + SUB // 2, SUB * x + SUB // 2]
        if face >= 0:
            z = _weights(q, faces[face, 0], faces[face, 1], faces[face, 2], cx, cy)[3]
            segmentation[y, x] = owners[face] + 1
            edge = False
        else:
            z, edge = _table_hit(view, cx, cy)
            segmentation[y, x] = 0
        depth[y, x] = z
        first = count
        kind[first] = face if face >= 0 else (TABLE if z > 0 else NOTHING)
        at[first, 0], at[first, 1], at[first, 2] = cx, cy, z
        pixel[first] = x
        count += 1
        if not edge and _single(triangle, x, y, face):
            share[first] = 1.0
            continue
        # Several surfaces meet here: one representative for each, weighted by its number of samples.
        share[first] = 0.0
        for j in range(SUB * y, SUB * y + SUB):
            for i in range(SUB * x, SUB * x + SUB):
                other = triangle[j, i]
                z = 0.0
                if other < 0:
                    z = _table_hit(view, i + 0.5, j + 0.5)[0]
                    other = TABLE if z > 0 else NOTHING
                known = first
                while known < count and not (
                    kind[known] == other
                    or (other >= 0 and kind[known] >= 0 and _smooth(owners, normals, kind[known], other))
                ):
                    known += 1
                if known == count:
                    kind[count], pixel[count], share[count] = other, x, 0.0
                    at[count, 0], at[count, 1], at[count, 2] = i + 0.5, j + 0.5, z
                    count += 1
                share[known] += 1.0 / (SUB * SUB)
    return count


@inner
def _locate(view, mesh, skins, q, poses, materials, s, rich, row, count):
    """Compute position, normal, texture and ambient light of each collected sample."""
    faces, owners, v, w = mesh.faces, mesh.owners, mesh.vertices, mesh.normals
    kind, owner, at, point, normal, look = row.kind, row.owner, row.at, row.point, row.normal, row.look
    occlusion, occlusion_frame, light, blur = s.occlusion, s.occlusion_frame, row.light, row.blur
    up = 1.0 if view[2, 3] > 0 else -1.0
    for r in range(count):
        face = kind[r]
        sx, sy = at[r, 0], at[r, 1]
        ray = _world_ray(view, sx, sy)
        row.fade[r] = 0.0
        if face == NOTHING:
            owner[r] = NOTHING
            if rich is None:
                continue
            if ray[2] * up >= 0:
                continue
            # The table goes on beyond its border and fades into the backdrop.
            at[r, 2] = -view[2, 3] / ray[2]
            x, y = view[0, 3] + at[r, 2] * ray[0], view[1, 3] + at[r, 2] * ray[1]
            far = max((max(abs(x), abs(y)) / view[3, 0] - 1) / SWEEP, 0.0)
            if far >= 1:
                continue
            face = TABLE
            row.fade[r] = far * far * (3 - 2 * far)
        e = _unit(-ray[0], -ray[1], -ray[2])
        wa = wb = wc = 0.0
        if face == TABLE:
            o = TABLE
            z = at[r, 2]
            n = (0.0, 0.0, up)
            x, y, h = view[0, 3] + z * ray[0], view[1, 3] + z * ray[1], 0.0
            p = (x, y, h)
        else:
            o = owners[face]
            i, j, k = faces[face, 0], faces[face, 1], faces[face, 2]
            # Position in the object frame, for the texture; normal in the world.
            wa, wb, wc, z = _weights(q, i, j, k, sx, sy)
            a, b, c = wa, wb, wc
            x = a * v[i, 0] + b * v[j, 0] + c * v[k, 0]
            y = a * v[i, 1] + b * v[j, 1] + c * v[k, 1]
            h = a * v[i, 2] + b * v[j, 2] + c * v[k, 2]
            nx = a * w[face, 0, 0] + b * w[face, 1, 0] + c * w[face, 2, 0]
            ny = a * w[face, 0, 1] + b * w[face, 1, 1] + c * w[face, 2, 1]
            nz = a * w[face, 0, 2] + b * w[face, 1, 2] + c * w[face, 2, 2]
            n = _unit(
                poses[o, 0, 0] * nx + poses[o, 0, 1] * ny + poses[o, 0, 2] * nz,
                poses[o, 1, 0] * nx + poses[o, 1, 1] * ny + poses[o, 1, 2] * nz,
                poses[o, 2, 0] * nx + poses[o, 2, 1] * ny + poses[o, 2, 2] * nz,
            )
            p = (view[0, 3] + z * ray[0], view[1, 3] + z * ray[1], view[2, 3] + z * ray[2])
        owner[r] = o
        blur[r] = 0.6 * view[3, 1] * z
        for c in range(3):
            point[r, c], normal[r, c], look[r, c] = p[c], n[c], e[c]
        # Second colour, averaged over the pixel's footprint; ambient occlusion around the objects' feet.
        toward = n[0] * e[0] + n[1] * e[1] + n[2] * e[2]
        axis = (materials[o, 8], materials[o, 9], materials[o, 10])
        width = view[3, 1] * z / max(toward, 0.3)
        if skins is not None and materials[o, 6] == IMAGE and face >= 0:
            # Between the sides of the pixel's footprint, which is longer along the slope.
            across = view[3, 1] * z / math.sqrt(max(toward, 0.1))
            row.second[r] = 0.0
            _skin(skins, face, wa, wb, wc, across, rich is not None, row.albedo[r])
        else:
            row.second[r] = _texture(rich, int(materials[o, 6]), materials[o, 7], axis, x, y, h, width)
        shade = _occlusion_at(occlusion, occlusion_frame, p[0], p[1])
        light[r, 0] = 1.0
        light[r, 1] = min(0.75 * shade, 1.0) if o == TABLE else 0.0
        light[r, 2] = 0.0 if o == TABLE else min(1.2 * shade * AO_LENGTH / (AO_LENGTH + max(p[2], 0.0)), 1.0)
        if rich is not None:
            row.mirrored[r, 0] = -1.0
            if o == TABLE:
                light[r, 1] = shade
            else:
                # The table hides half of the room from the foot of an object, where it is dark itself.
                low = AO_LENGTH / (AO_LENGTH + 2 * max(p[2], 0.0))
                light[r, 1] = 0.5 * shade * low * low * (1 - max(n[2], 0.0))
                if materials[o, 12] > 0:  # the others reflect too little
                    _mirror(s, materials, row, r, n, e, materials[o, 11])


@inner
def _shadow(s, shadow, row, count):
    """Share of the first light's disc that each collected sample sees: percentage-closer soft shadows (Fernando 2005).

    The receiver is taken as a plane around each sample, so that a tilted surface does not shade itself.
    """
    receiver, point, normal, light, blur = row.owner, row.point, row.normal, row.light, row.blur
    front, back, owner = shadow.texels[0], shadow.texels[1], shadow.texels[2]
    tiles, counts, axes = shadow.tiles, shadow.counts, shadow.axes
    low_u, low_v, scale, least = shadow.frame
    spread = s.lights[0, 7]
    size, tile = len(front), len(front) // len(tiles)
    for r in range(count):
        o = receiver[r]
        if o == NOTHING:
            continue
        nx, ny, nz = normal[r, 0], normal[r, 1], normal[r, 2]
        facing = axes[2, 0] * nx + axes[2, 1] * ny + axes[2, 2] * nz
        if facing <= 0:
            continue
        # The sample in light space, and the radius in which something could hide part of the light.
        x, y, z = point[r, 0], point[r, 1], point[r, 2]
        d = -(axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z)
        reach = (spread * max(d - least, 0.0) + blur[r]) * scale
        u = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - low_u) * scale
        v = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - low_v) * scale
        if u + reach < 0 or v + reach < 0 or u - reach > size or v - reach > size:
            continue
        # Slope of the receiver's plane in metres per texel.
        steep = 1 / (max(facing, 0.25) * scale)
        du = (axes[0, 0] * nx + axes[0, 1] * ny + axes[0, 2] * nz) * steep
        dv = (axes[1, 0] * nx + axes[1, 1] * ny + axes[1, 2] * nz) * steep
        box = _may_block(tiles, counts, tile, u, v, d, du, dv, reach, o)
        if box[0] > box[1]:
            continue
        if o == TABLE:
            light[r, 0] = _lit_share(front, back, owner, box, u, v, d, du, dv, reach, spread, blur[r], scale, None)
        else:
            light[r, 0] = _lit_share(front, back, owner, box, u, v, d, du, dv, reach, spread, blur[r], scale, o)


@kernel
def shade(
    view,
    mesh,
    skins,
    homogeneous,
    triangle,
    poses,
    materials,
    surroundings,
    rich,
    shadow,
    row,
    rgb,
    depth,
    segmentation,
):
    """Colour, depth and id of every pixel; the last row of `materials` is the table's.

    `skins` is None without textures. `rich` is True if surfaces reflect a room and the table fades into the backdrop,
    and None if not. For None, numba leaves out what is not needed, which shortens the first run on a machine.
    """
    for y in range(len(depth)):
        count = _collect(view, mesh, homogeneous, triangle, y, row, depth, segmentation)
        _locate(view, mesh, skins, homogeneous, poses, materials, surroundings, rich, row, count)
        if surroundings.casts_shadow:
            _shadow(surroundings, shadow, row, count)
        _reflect(row, count, surroundings, rich, materials)
        row.total[:] = 0
        _blend(row.color, row.share, row.pixel, count, row.total, y, rgb)


@inner
def _blend(color, share, pixel, count, total, y, rgb):
    for r in range(count):
        for c in range(3):
            total[pixel[r], c] += share[r] * color[r, c]
    for x in range(len(total)):
        for c in range(3):
            rgb[y, x, c] = SRGB[min(max(int(total[x, c] * len(SRGB)), 0), len(SRGB) - 1)]
