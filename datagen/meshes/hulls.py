"""Convex hulls of a mesh for physics, by CoACD in a process with a time limit, cached by content hash.

CoACD (Wei et al. 2022) cuts a mesh along planes until every piece nearly fills its convex hull.
"""

import hashlib
import io
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull, QhullError

from datagen.errors import DatagenError, UsageError
from datagen.meshes.distance import MeshSolid
from datagen.meshes.topology import signed_volume
from datagen.storage.atomic import cache_folder, write_atomically
from datagen.storage.safe_io import read_npz

CONVEX_SHARE = 0.97
"""Share of its convex hull that a mesh must fill to be taken for convex."""

MOST_CORNERS = 48
"""Largest number of corners of a hull before the corners of the mesh that it misses are added."""

MISSED = 2e-4
"""Metres by which a corner of the mesh may lie outside of all hulls before it is added to the nearest one."""

OPTIONS = {
    "threshold": 0.05,
    "max_convex_hull": 32,
    "mcts_iterations": 30,
    "mcts_nodes": 12,
    "mcts_max_depth": 2,
    "resolution": 1000,
    "preprocess_resolution": 30,
}
"""Options of CoACD, which takes about 25 CPU-seconds with them for a YCB mug, and minutes with its defaults."""

_WALL = 20
"""Seconds of wall time per second of the limit, which counts CPU time, so that it does not depend on the load."""

_VERSION = 1
"""Raised when hulls of the same mesh change."""


@dataclass(frozen=True, eq=False)
class Hulls:
    """Convex hulls that together cover a mesh, in its units and axes."""

    parts: tuple[Float[np.ndarray, "_ 3"], ...]
    method: str
    """`convex`: the mesh nearly fills its hull; `coacd`; `time limit`: CoACD took too long, one hull is used;
    `failed`: CoACD gave no result, one hull is used."""
    beyond: float
    """Largest distance by which the hulls extend beyond the surface, in the mesh's units."""

    @property
    def sha256(self) -> str:
        """Hash of all corners."""
        digest = hashlib.sha256()
        for part in self.parts:
            digest.update(np.ascontiguousarray(part, "<f8").tobytes() + b"|")
        return digest.hexdigest()


def find_hulls(
    key: str,
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    *,
    closed: bool,
    seconds: float,
) -> Hulls:
    """Hulls of a mesh from the cache, or computed and stored there; `key` is the mesh's content hash.

    `seconds` is the CPU time that CoACD may take.

    Hulls after a time limit are stored too, together with the limit: a longer one tries again. Failures are not
    stored, because CoACD may have been killed.

    Raises:
        UsageError: CoACD is needed and not installed.
    """
    path = cache_folder() / "hulls" / f"{key}-{_VERSION}.npz"
    if (known := _stored(path, seconds)) is not None:
        return known
    hulls = _decompose(vertices, faces, closed=closed, seconds=seconds)
    if hulls.method == "failed":
        return hulls
    buffer = io.BytesIO()
    np.savez(
        buffer,
        corners=np.concatenate(hulls.parts),
        counts=np.array([len(part) for part in hulls.parts]),
        method=np.array(hulls.method),
        beyond=np.array(hulls.beyond),
        seconds=np.array(seconds),
    )
    write_atomically(path, buffer.getvalue())
    return hulls


def _stored(path: Path, seconds: float) -> Hulls | None:
    try:
        found = read_npz(path, ("corners", "counts", "method", "beyond", "seconds"))
        corners, counts, method = found["corners"], found["counts"], str(found["method"])
        if method == "time limit" and float(found["seconds"]) < seconds:
            return None
        parts = tuple(np.split(corners, np.cumsum(counts)[:-1]))
        return Hulls(parts, method, float(found["beyond"]))
    except (OSError, DatagenError, KeyError, ValueError, TypeError):
        return None


def _decompose(vertices: np.ndarray, faces: np.ndarray, *, closed: bool, seconds: float) -> Hulls:
    solid = MeshSolid(vertices, faces, closed=closed)
    whole = convex_corners(vertices)
    volume = signed_volume(vertices, faces) if closed else 0.0
    if volume > CONVEX_SHARE * ConvexHull(whole).volume:
        return Hulls((whole,), "convex", overshoot((whole,), solid))
    parts = _run_coacd(vertices, faces, seconds)
    if isinstance(parts, str):
        return Hulls((whole,), parts, overshoot((whole,), solid))
    parts = _covering(parts, vertices)
    return Hulls(parts, "coacd", overshoot(parts, solid))


def convex_corners(points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "corner 3"]:
    """Corners of the convex hull of some points."""
    return points[ConvexHull(points).vertices]


def _run_coacd(vertices: np.ndarray, faces: np.ndarray, seconds: float) -> tuple[np.ndarray, ...] | str:
    """Run CoACD in a process of its own, which can be stopped; a method of `Hulls` if there is no result."""
    try:
        metadata.version("coacd")
    except metadata.PackageNotFoundError:
        raise UsageError(
            "Cutting meshes into convex hulls needs CoACD, which is not installed. "
            "Install it with `pip install 'obpose[meshes]'`."
        ) from None
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "mesh.npz", Path(folder) / "hulls.npz"
        np.savez(source, vertices=vertices, faces=faces)
        command = [sys.executable, "-m", "datagen.meshes.coacd_process", str(source), str(target), f"{seconds:.0f}"]
        command.append(str(os.getpid()))
        # One thread: CoACD's result depends on their number.
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        try:
            done = subprocess.run(command, env=environment, timeout=_WALL * seconds, capture_output=True, check=False)
        except subprocess.TimeoutExpired:
            return "time limit"
        if done.returncode == -signal.SIGXCPU:
            return "time limit"
        if done.returncode or not target.exists():
            return "failed"
        found = read_npz(target, ("corners", "counts"))
    return tuple(np.split(found["corners"], np.cumsum(found["counts"])[:-1]))


def _covering(parts: Sequence[np.ndarray], vertices: np.ndarray) -> tuple[np.ndarray, ...]:
    """Extend hulls to the corners of the mesh that CoACD, which works on a coarser copy, leaves outside."""
    hulls = [hull for part in parts if (hull := _hull(part)) is not None]
    outside = np.stack([np.max(vertices @ h.equations[:, :3].T + h.equations[:, 3], axis=1) for h in hulls])
    nearest, distance = np.argmin(outside, axis=0), np.min(outside, axis=0)
    size = float(np.max(np.ptp(vertices, axis=0)))
    missed = distance > min(MISSED, 2e-3 * size)
    return tuple(
        convex_corners(np.concatenate([hull.points[hull.vertices], vertices[missed & (nearest == row)]]))
        for row, hull in enumerate(hulls)
    )


def _hull(points: np.ndarray) -> ConvexHull | None:
    try:
        return ConvexHull(points)
    except (QhullError, ValueError):
        return None


def overshoot(parts: Sequence[Float[np.ndarray, "_ 3"]], solid: MeshSolid) -> float:
    """Largest distance by which hulls extend beyond the surface, measured at their corners and across their faces."""
    points = []
    for part in parts:
        hull = ConvexHull(part)
        corners = hull.points[hull.simplices]
        weights = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])
        points.append((weights @ corners).reshape(-1, 3))
    samples = np.concatenate(points)
    far = solid.distance(samples)
    worst = np.argsort(-far)
    for start in range(0, len(worst), 256):
        rows = worst[start : start + 256]
        beyond = far[rows[~solid.inside(samples[rows])]]
        if len(beyond):
            return float(np.max(beyond))
    return 0.0
