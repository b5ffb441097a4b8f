"""Convex hulls cover a mesh, come from a cache, and fall back to one hull after the time limit."""

from importlib import metadata, util
from pathlib import Path

import numpy as np
import pytest
import trimesh

from datagen.errors import UsageError
from datagen.meshes import hulls
from datagen.meshes.distance import MeshSolid
from datagen.meshes.hulls import find_hulls, overshoot
from tests.worlds.meshes import BOX, triangles

needs_coacd = pytest.mark.skipif(util.find_spec("coacd") is None, reason="needs obpose[meshes]")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path))
    return tmp_path


def ell() -> tuple[np.ndarray, np.ndarray]:
    """An angle of two bars, 8 cm long."""
    polygon = [(0, 0), (8, 0), (8, 2), (2, 2), (2, 8), (0, 8)]
    pieces = [(0, 1, 2, 3), (0, 3, 4, 5)]
    bottom, top = [(0.01 * x, 0.01 * y, 0.0) for x, y in polygon], [(0.01 * x, 0.01 * y, 0.02) for x, y in polygon]
    faces = [(p[0], p[i], p[i + 1]) for p in pieces for i in (1, 2)]
    sides = [(i, (i + 1) % 6, (i + 1) % 6 + 6) for i in range(6)] + [(i, (i + 1) % 6 + 6, i + 6) for i in range(6)]
    caps = [(a + 6, b + 6, c + 6) for a, b, c in faces] + [(c, b, a) for a, b, c in faces]
    return np.array(bottom + top), np.array(caps + sides)


def test_a_convex_mesh_is_its_own_hull():
    found = find_hulls("box", 0.05 * BOX, triangles(), closed=True, seconds=10.0)
    assert found.method == "convex"
    assert found.beyond == pytest.approx(0)


@needs_coacd
def test_an_angle_is_cut_and_cached(monkeypatch: pytest.MonkeyPatch):
    vertices, faces = ell()
    assert trimesh.Trimesh(vertices, faces).is_watertight
    found = find_hulls("ell", vertices, faces, closed=True, seconds=60.0)
    assert found.method == "coacd"
    assert len(found.parts) > 1
    assert found.beyond < 0.002 < overshoot((vertices,), MeshSolid(vertices, faces, closed=True))
    monkeypatch.setattr(hulls, "_decompose", None)
    assert find_hulls("ell", vertices, faces, closed=True, seconds=60.0).sha256 == found.sha256


@needs_coacd
def test_after_the_time_limit_one_hull_is_used():
    # Importing CoACD alone takes some of the second that it gets.
    ring = trimesh.creation.torus(0.05, 0.015, major_sections=96, minor_sections=48)
    found = find_hulls("ring", np.array(ring.vertices), np.array(ring.faces), closed=True, seconds=1.0)
    assert (found.method, len(found.parts)) == ("time limit", 1)


def test_without_coacd_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    def missing(_name: str) -> str:
        raise metadata.PackageNotFoundError

    monkeypatch.setattr(metadata, "version", missing)
    with pytest.raises(UsageError, match=r"pip install 'obpose\[meshes\]'"):
        find_hulls("ell", *ell(), closed=True, seconds=10.0)
