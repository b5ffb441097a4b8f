"""Objects as triangle meshes in metres, coloured by their fields."""

import math
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
import trimesh
from jaxtyping import Float
from skimage.measure import marching_cubes
from torch import Tensor
from trimesh.visual import ColorVisuals

from datagen.geometry import LINEAR
from datagen.storage.atomic import write_atomically
from obpose.errors import UsageError
from obpose.geometry import from_box
from obpose.model.nerf.along import JITTER
from obpose.model.obpose import ObPose
from obpose.pictures import to_bytes
from obpose.scenes.rendering import object_codes
from obpose.scenes.scene import Scene

FORMATS = (".ply", ".glb")
_CHUNK = 1 << 15
"""Number of points of the lattice that are evaluated at once, to bound memory."""
_EMPTY = -20.0
"""Logit outside of the box."""
SURFACE, SURFACE_OF_FIELD = 0.5, 0.9
"""Density at the surface, as a share of the largest, of meshes that shrink to what frames showed, and of others whose
objects have no extents: docs/create.md, section Meshes."""


@torch.no_grad()
def object_mesh(
    model: ObPose,
    scene: Scene,
    name: int,
    *,
    frame: int = 0,
    resolution: int = 48,
    floor: float | None = None,
    surface: float | None = None,
) -> trimesh.Trimesh:
    """Extract the surface of an object from its density (marching cubes, Lorensen and Cline 1987).

    The mesh is in the world frame, in metres. The faces of the object's box close it where the field reaches beyond
    them. Fields are larger than their objects, so the mesh shrinks along each axis of the box to what the frames showed
    (`Appearance.half_extent`). The colour of a vertex is the field's as far behind it as it was trained, seen from
    outside.

    The field is evaluated at `resolution` points along each edge of the box. The mesh is cut at the height `floor` in
    the world, metres, because no camera saw what is below a table. `surface` is the density at the surface, as a share
    of the largest; by default `SURFACE`, or `SURFACE_OF_FIELD` if the extents of the object are unknown.

    Raises:
        UsageError: there is no such object, or it is nowhere dense.
    """
    place, settings = scene.place(name), model.config.model
    codes = object_codes(model, scene, frame, place)
    steps = torch.linspace(-1, 1, resolution)
    lattice = torch.cartesian_prod(steps, steps, steps)
    center, rotation = scene.center[frame, place], scene.rotation[frame, place]
    half_extent = scene.appearance.half_extent[place]
    if surface is None:
        surface = SURFACE if bool(half_extent.any()) else SURFACE_OF_FIELD
    # The level is the inverse of tanh(softplus(logit)) (paper, end of section Decoder).
    level = math.log(math.expm1(math.atanh(surface)))
    logits = torch.cat([model.object_field.density(part, codes)[0] for part in lattice.split(_CHUNK)])
    if floor is not None:
        # A field that crosses the level at the floor, one logit per step of the lattice.
        height = from_box(lattice, center, rotation, settings.pose.box_size)[:, 2] - floor
        logits = torch.minimum(logits, level + height * (resolution - 1) / settings.pose.box_size)
    around = np.pad(logits.view(resolution, resolution, resolution).numpy(), 1, constant_values=_EMPTY)
    if around.max() <= level:
        raise UsageError(
            f"Object {name} is dense at none of {resolution} x {resolution} x {resolution} points of its box; there is "
            "nothing to make a mesh of, unless more of them (--cells) find something."
        )
    corners, faces, _, _ = marching_cubes(around, level)
    # The padding lies a step outside the box; what it closes is cut off there.
    in_box = torch.from_numpy((corners - 1) * (2 / (resolution - 1)) - 1).to(lattice.dtype).clamp(-1, 1)
    mesh = trimesh.Trimesh(from_box(in_box, center, rotation, settings.pose.box_size).numpy(), faces, process=False)
    mesh.fix_normals()
    # Colours as far behind the surface as they were trained, seen from outside.
    inwards = -F.normalize(torch.from_numpy(np.array(mesh.vertex_normals)).to(lattice.dtype) @ rotation, dim=-1)
    _, hidden = model.object_field.density(in_box + 2 * JITTER / settings.pose.box_size * inwards, codes)
    colours = model.object_field.colour(hidden, inwards, codes)
    seen = _shrink(in_box, 2 * half_extent / settings.pose.box_size)
    mesh.vertices = from_box(seen, center, rotation, settings.pose.box_size).numpy()
    mesh.visual = ColorVisuals(mesh, vertex_colors=to_bytes(colours))
    return mesh


def _shrink(vertices: Float[Tensor, "vertex 3"], half: Float[Tensor, "3"]) -> Float[Tensor, "vertex 3"]:
    """Scale vertices along each axis to the part of their range that is in a box of these half edges; 0: keep them."""
    low, high = vertices.amin(dim=0), vertices.amax(dim=0)
    known = (half > 0) & (low < half) & (high > -half)
    to_low, to_high = torch.where(known, low.maximum(-half), low), torch.where(known, high.minimum(half), high)
    return to_low + (vertices - low) * (to_high - to_low) / (high - low).clamp(min=1e-6)


def write_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write PLY or GLB, by the suffix of the path, atomically.

    Raises:
        UsageError: the path has another suffix.
    """
    if path.suffix not in FORMATS:
        raise UsageError(f"{path}: expected a name that ends with {' or '.join(FORMATS)}.")
    data = to_glb(mesh) if path.suffix == ".glb" else mesh.export(file_type=path.suffix[1:])
    assert isinstance(data, bytes)
    write_atomically(path, data)


def to_glb(mesh: trimesh.Trimesh) -> bytes:
    """Encode a mesh as GLB, whose vertex colours are linear (glTF 2.0); those of the mesh are sRGB."""
    encoded = mesh.copy()
    colours = np.array(mesh.visual.vertex_colors)  # pyright: ignore
    colours[:, :3] = (255 * LINEAR[colours[:, :3]]).round()
    encoded.visual.vertex_colors = colours  # pyright: ignore
    data = encoded.export(file_type="glb")
    assert isinstance(data, bytes)
    return data
