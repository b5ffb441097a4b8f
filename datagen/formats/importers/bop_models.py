"""Models of BOP: boxes of least volume around their meshes, and symmetries from models_info.json.

models/models_info.json   size and symmetries of each model, by obj_id
models/obj_000001.ply     mesh in millimetres; a folder models_eval with smaller meshes is preferred
"""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import QhullError

from datagen.errors import CorruptFile, UsageError
from datagen.formats.importers.interface import Model
from datagen.meshes.hulls import convex_corners
from datagen.meshes.read import read_mesh
from datagen.rgbd.files import numbers, read_object
from datagen.shapes.geometry.bounding import Outline, minimum_box
from datagen.shapes.symmetry import name_group

INFORMATION = "models_info.json"
METRES = 0.001
"""Metres per millimetre, the unit of BOP."""


def find_models(source: Path) -> "Models | None":
    """Find the models beside or above some scenes."""
    folders = (place / name for place in (source, *source.resolve().parents[:2]) for name in ("models_eval", "models"))
    return next((Models(folder) for folder in folders if (folder / INFORMATION).exists()), None)


class Models:
    """Models in a folder, read when they are first used."""

    def __init__(self, folder: Path):
        self._folder = folder
        self._information = read_object(folder / INFORMATION)
        self._models: dict[int, Model] = {}

    def model(self, number: int) -> Model:
        """The model of an obj_id.

        Raises:
            UsageError: its mesh is missing.
            CorruptFile: its mesh is damaged or flat, or its entry in models_info.json is damaged.
        """
        if number not in self._models:
            path = self._folder / f"obj_{number:06d}.ply"
            if not path.exists():
                raise UsageError(
                    f"{path} is missing, but scene_gt.json names its object. Complete the models, or take the folder "
                    "away to import poses without boxes."
                )
            mesh = read_mesh(self._folder, path.name)
            try:
                points = METRES * convex_corners(mesh.vertices)
            except QhullError:
                raise CorruptFile(f"{path} is flat; expected a solid object. Restore the original.") from None
            box = minimum_box(Outline.of_points(points))
            self._models[number] = Model(np.ptp(points, axis=0), box, self.symmetry(number) or "C1")
        return self._models[number]

    def symmetry(self, number: int) -> str | None:
        """Rotation group of a model; None if it has no name, see `datagen.shapes.symmetry`."""
        place, facts = f"{self._folder / INFORMATION}: model {number}", self._information.get(str(number), {})
        turns, axes = (_list(facts, f"symmetries_{kind}", place) for kind in ("discrete", "continuous"))
        rotations = [numbers(turn, 16, place).reshape(4, 4)[:3, :3] for turn in turns]
        vectors = [numbers(_entry(axis, place).get("axis"), 3, place) for axis in axes]
        lengths = np.linalg.norm(np.reshape(vectors, (-1, 3)), axis=1, keepdims=True)
        if np.any(lengths == 0):
            raise CorruptFile(f"{place} has an axis of symmetry without length.")
        return name_group(np.reshape(rotations, (-1, 3, 3)), np.reshape(vectors, (-1, 3)) / lengths)


def _entry(values: Any, place: str) -> dict[str, Any]:
    if type(values) is not dict:
        raise CorruptFile(f"{place} is {values!r:.60}; expected an object with keys.")
    return values


def _list(values: Any, key: str, place: str) -> list[Any]:
    found = _entry(values, place).get(key, [])
    if type(found) is not list:
        raise CorruptFile(f"{place}: {key} is {found!r:.60}; expected a list.")
    return found
