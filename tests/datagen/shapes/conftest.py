from collections.abc import Callable

import numpy as np
import pytest

from datagen.shapes.geometry.mesh import Mesh
from datagen.shapes.shape import Shape


@pytest.fixture
def surface_samples() -> Callable[[Mesh | Shape, int], np.ndarray]:
    """Points spread evenly over a mesh's triangles."""

    def sample(mesh: Mesh | Shape, count: int) -> np.ndarray:
        rng = np.random.default_rng(0)
        corners = mesh.vertices[mesh.faces]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        chosen = rng.choice(len(corners), count, p=areas / areas.sum())
        return np.einsum("pc,pcx->px", rng.dirichlet([1, 1, 1], count), corners[chosen])

    return sample
