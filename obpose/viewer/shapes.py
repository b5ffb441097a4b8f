"""Recovered shapes in their objects' frames, remembered: an edit needs no new ones."""

from dataclasses import replace

import torch

from obpose.errors import UsageError
from obpose.model.obpose import ObPose
from obpose.scenes.scene import Scene

_CELLS = 32
"""Points along each edge of a box."""
_KEPT = 512


class Shapes:
    """Meshes of objects by their codes, as GLB."""

    def __init__(self, model: ObPose):
        self._model = model
        self._known: dict[bytes, bytes | None] = {}

    def of(self, scene: Scene, frame: int, name: int) -> bytes | None:
        """The surface of an object, metres, the middle of its box at the origin; None where it is nowhere dense."""
        look = scene.look(frame, scene.place(name))
        if look not in self._known:
            if len(self._known) >= _KEPT:
                self._known.clear()
            self._known[look] = self._make(scene, frame, name)
        return self._known[look]

    def _make(self, scene: Scene, frame: int, name: int) -> bytes | None:
        # Late, because trimesh and marching cubes take a second to import, for which the first picture need not wait.
        from obpose.scenes.meshes import object_mesh

        upright = torch.eye(3).expand_as(scene.rotation)
        posed = replace(scene, center=torch.zeros_like(scene.center), rotation=upright)
        try:
            mesh = object_mesh(self._model, posed, name, frame=frame, resolution=_CELLS)
        except UsageError:
            return None
        data = mesh.export(file_type="glb")
        assert isinstance(data, bytes)
        return data
