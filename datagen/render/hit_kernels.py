"""Inner loops of `datagen.render.hits`, compiled by numba; plain arrays in, plain arrays out."""

import numpy as np

from datagen.render.kernels import NEAR, kernel

TILE = 12
"""Side of the squares of the image that list the triangles in them, samples; a pixel has 3x3 samples."""

REACH = 1.5
"""Distance in samples to which the nearest triangle is used where a renderer draws an object beside its triangles."""

ANY = -1
"""Owner of points that may lie on any object."""


@kernel
def list_faces(homogeneous, screen, faces, tiles_x, tiles_y):
    """Triangles that face the camera by the tiles that they may touch: `items[starts[t] : starts[t + 1]]`."""
    spans = np.zeros((len(faces), 4), np.int64)
    starts = np.zeros(tiles_x * tiles_y + 1, np.int64)
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        spans[f, 0] = 1  # an empty span
        if not (homogeneous[i, 2] > NEAR and homogeneous[j, 2] > NEAR and homogeneous[k, 2] > NEAR):
            continue  # Scenes keep everything in view beyond NEAR.
        xi, xj, xk = screen[i, 0], screen[j, 0], screen[k, 0]
        yi, yj, yk = screen[i, 1], screen[j, 1], screen[k, 1]
        if (xj - xi) * (yk - yi) - (yj - yi) * (xk - xi) >= 0:
            continue
        x0, x1 = min(xi, min(xj, xk)) - REACH, max(xi, max(xj, xk)) + REACH
        y0, y1 = min(yi, min(yj, yk)) - REACH, max(yi, max(yj, yk)) + REACH
        if x1 < 0 or y1 < 0 or x0 >= tiles_x * TILE or y0 >= tiles_y * TILE:
            continue
        spans[f, 0], spans[f, 1] = max(int(x0 / TILE), 0), min(int(x1 / TILE), tiles_x - 1)
        spans[f, 2], spans[f, 3] = max(int(y0 / TILE), 0), min(int(y1 / TILE), tiles_y - 1)
        for y in range(spans[f, 2], spans[f, 3] + 1):
            for x in range(spans[f, 0], spans[f, 1] + 1):
                starts[y * tiles_x + x + 1] += 1
    for t in range(len(starts) - 1):
        starts[t + 1] += starts[t]
    items, filled = np.empty(starts[-1], np.int32), starts[:-1].copy()
    for f in range(len(faces)):
        for y in range(spans[f, 2], spans[f, 3] + 1):
            for x in range(spans[f, 0], spans[f, 1] + 1):
                items[filled[y * tiles_x + x]] = f
                filled[y * tiles_x + x] += 1
    return starts, items


@kernel
def _edges(homogeneous, i, j, k):
    """Coefficients of a triangle's edge functions and its determinant, see `kernels.rasterise`."""
    qix, qiy, zi = homogeneous[i, 0], homogeneous[i, 1], homogeneous[i, 2]
    qjx, qjy, zj = homogeneous[j, 0], homogeneous[j, 1], homogeneous[j, 2]
    qkx, qky, zk = homogeneous[k, 0], homogeneous[k, 1], homogeneous[k, 2]
    ax, ay, az = qjy * zk - zj * qky, zj * qkx - qjx * zk, qjx * qky - qjy * qkx
    bx, by, bz = qky * zi - zk * qiy, zk * qix - qkx * zi, qkx * qiy - qky * qix
    cx, cy, cz = qiy * zj - zi * qjy, zi * qjx - qix * zj, qix * qjy - qiy * qjx
    return ax, ay, az, bx, by, bz, cx, cy, cz, qix * ax + qiy * ay + zi * az


@kernel
def hit(points, owners, homogeneous, faces, face_owners, starts, items, tiles_x, tiles_y, face, weights, inverse):
    """Fill `face`, `weights` and `inverse`; see `hits.Hits`."""
    for p in range(len(points)):
        sx, sy = points[p, 0], points[p, 1]
        if not (sx >= 0 and sy >= 0 and sx < tiles_x * TILE and sy < tiles_y * TILE):
            continue
        tile = int(sy / TILE) * tiles_x + int(sx / TILE)
        best, nearest = 0.0, REACH
        # Triangles whose boxes meet the tile of the point.
        for item in range(starts[tile], starts[tile + 1]):
            f = items[item]
            if owners[p] != ANY and face_owners[f] != owners[p]:
                continue
            ax, ay, az, bx, by, bz, cx, cy, cz, det = _edges(homogeneous, faces[f, 0], faces[f, 1], faces[f, 2])
            if det >= 0:
                continue
            a, b, c = ax * sx + (ay * sy + az), bx * sx + (by * sy + bz), cx * sx + (cy * sy + cz)
            depth = (a + b + c) * (1 / det)
            if a > 0 or b > 0 or c > 0:
                if owners[p] == ANY or best > 0:
                    continue
                # Beside the triangle: keep the nearest one in case that the point lies beside all of them.
                outside = max(
                    a / np.sqrt(ax * ax + ay * ay),
                    max(b / np.sqrt(bx * bx + by * by), c / np.sqrt(cx * cx + cy * cy)),
                )
                if outside >= nearest:
                    continue
                nearest = outside
                a, b, c = min(a, 0.0), min(b, 0.0), min(c, 0.0)
            elif depth > best:
                best = depth
            else:
                continue
            # Weights of the corners, and the inverse depth that they interpolate.
            total = a + b + c
            face[p], inverse[p] = f, total * (1 / det)
            weights[p, 0], weights[p, 1], weights[p, 2] = a / total, b / total, c / total


@kernel
def inside(points, row, homogeneous, faces, face_owners, starts, items, tiles_x):
    """Whether a triangle of one object covers each point."""
    covered = np.zeros(len(points), np.bool_)
    for p in range(len(points)):
        sx, sy = points[p, 0], points[p, 1]
        tile = int(sy / TILE) * tiles_x + int(sx / TILE)
        for item in range(starts[tile], starts[tile + 1]):
            f = items[item]
            if face_owners[f] != row:
                continue
            ax, ay, az, bx, by, bz, cx, cy, cz, det = _edges(homogeneous, faces[f, 0], faces[f, 1], faces[f, 2])
            if det >= 0:
                continue
            a, b, c = ax * sx + (ay * sy + az), bx * sx + (by * sy + bz), cx * sx + (cy * sy + cz)
            if not (a > 0 or b > 0 or c > 0):
                covered[p] = True
                break
    return covered
