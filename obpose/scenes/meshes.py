"""Objects as triangle meshes in metres, coloured by their fields."""

from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
import trimesh
from jaxtyping import Float
from skimage.measure import marching_cubes
from torch import Tensor
from trimesh.visual import ColorVisuals

from datagen.storage.atomic import write_atomically
from obpose.errors import UsageError
from obpose.geometry import from_box
from obpose.model.nerf.field import Conditioning
from obpose.model.nerf.voxels import occupancy
from obpose.model.obpose import ObPose
from obpose.scenes.rendering import object_codes
from obpose.scenes.scene import Scene

FORMATS = (".ply", ".glb")


@torch.no_grad()
def object_mesh(model: ObPose, scene: Scene, name: int, *, frame: int = 0, resolution: int = 48) -> trimesh.Trimesh:
    """The surface at which the object's own density crosses sigma_T (marching cubes, Lorensen and Cline 1987).

    World frame, metres; `resolution` points along each edge of the box, whose faces close what reaches beyond them. The
    colour of a vertex is the field's as far behind it as it was trained, seen from outside.

    Raises:
        UsageError: there is no such object, or it is nowhere dense.
    """
    place, settings = scene.place(name), model.config.model
    codes = object_codes(model, scene, frame, place)
    steps = torch.linspace(-1, 1, resolution)
    lattice = torch.cartesian_prod(steps, steps, steps)
    density = occupancy(model.object_field.density(lattice, codes)[0]).view(resolution, resolution, resolution)
    around = np.pad(density.numpy(), 1)
    if around.max() <= settings.voxel_threshold:
        raise UsageError(
            f"Object {name} is dense at none of {resolution} x {resolution} x {resolution} points of its box; there is "
            "nothing to make a mesh of, unless more of them (--cells) find something."
        )
    corners, faces, _, _ = marching_cubes(around, settings.voxel_threshold)
    # The padding lies a step outside the box; what it closes is cut off there.
    in_box = torch.from_numpy((corners - 1) * (2 / (resolution - 1)) - 1).to(lattice.dtype).clamp(-1, 1)
    center, rotation = scene.center[frame, place], scene.rotation[frame, place]
    vertices = from_box(in_box, center, rotation, settings.pose.box_size)
    mesh = trimesh.Trimesh(vertices.numpy(), faces, process=False)
    mesh.fix_normals()
    outwards = torch.from_numpy(np.array(mesh.vertex_normals)).to(lattice.dtype) @ rotation
    colours = _colours(model, codes, in_box, outwards, behind=2 * model.config.loss.jitter / settings.pose.box_size)
    mesh.visual = ColorVisuals(mesh, vertex_colors=_bytes(colours))
    return mesh


def write_mesh(path: Path, mesh: trimesh.Trimesh) -> None:
    """Write PLY or GLB, by the ending of the name, whole or not at all.

    Raises:
        UsageError: another ending.
    """
    if path.suffix not in FORMATS:
        raise UsageError(f"{path}: expected a name that ends with {' or '.join(FORMATS)}.")
    data = mesh.export(file_type=path.suffix[1:])
    assert isinstance(data, bytes)
    write_atomically(path, data)


def _colours(
    model: ObPose,
    codes: Conditioning,
    points: Float[Tensor, "vertex 3"],
    outwards: Float[Tensor, "vertex 3"],
    *,
    behind: float,
) -> Float[Tensor, "vertex 3"]:
    inwards = -F.normalize(outwards, dim=-1)
    _, hidden = model.object_field.density(points + behind * inwards, codes)
    return model.object_field.colour(hidden, inwards, codes)


def _bytes(colours: Float[Tensor, "vertex 3"]) -> np.ndarray:
    return (colours.clamp(0, 1) * 255).round().to(torch.uint8).numpy()
