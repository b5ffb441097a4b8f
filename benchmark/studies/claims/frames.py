"""Objects in their own frames: how much they vary over time there (paper, figure 2).

Frames are named as in `PoseConfig.conditioning`: `none` stands still in the world, `location` follows T_hat, `full`
also turns with R.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Bool, Float
from torch import Tensor

from benchmark.studies.claims.scenes import Account, Found, Scene
from obpose.geometry import from_box
from obpose.model.nerf.voxels import FLOOR, THRESHOLD, lattice_points, observed_free, occupancy

Framing = Literal["none", "location", "full"]
FRAMINGS: tuple[Framing, ...] = ("none", "location", "full")


@dataclass(frozen=True, eq=False)
class Cells:
    """A cubic lattice that moves with an object."""

    center: Float[Tensor, "frame 3"]
    rotation: Float[Tensor, "frame 3 3"]
    """World from lattice."""
    size: float
    """Edge, metres."""
    resolution: int

    @property
    def points(self) -> Float[Tensor, "frame cell 3"]:
        """Middles of the cells, world frame."""
        lattice = lattice_points(self.resolution, None, self.center)
        return from_box(lattice, self.center, self.rotation, self.size)


@dataclass(frozen=True)
class Variance:
    """Over frames, of one object."""

    truth: float
    """Of the generator's shape, in the frames that the model infers."""
    centred: float
    """The same if these frames had the object's own origin: what their orientation does."""
    model: float
    """Of the shape that the model's field has."""


def cells_of(account: Account, found: Found, framing: Framing, *, edge: float, cell: float) -> Cells:
    """Cells of an edge `cell` around an object: a cube of the given edge, or for `none` one with all of its path."""
    inference = account.segmentation.inference
    upright = torch.eye(3).expand(len(found.frames), 3, 3)
    if framing == "none":
        path = inference.observed_center[0, found.frames, found.slot]
        low, high = path.amin(dim=0), path.amax(dim=0)
        resolution = int(np.ceil(((high - low).max().item() + edge) / cell))
        center = ((low + high) / 2).expand(len(found.frames), 3)
        return Cells(center, upright, resolution * cell, resolution)
    center = inference.boxes.center[0, found.frames, found.slot]
    if framing == "full":
        upright = inference.boxes.rotation[0, found.frames, found.slot]
    return Cells(center, upright, edge, round(edge / cell))


def variance(account: Account, found: Found, framing: Framing) -> Variance:
    """On voxels of the size that boxes of 20 cm have with the model's S."""
    config = account.model.config
    edge = config.model.pose.box_size
    cells = cells_of(account, found, framing, edge=edge, cell=edge / config.model.voxels)
    centred = cells
    if framing != "none":
        poses = account.scene.truth.world_from_object[found.frames, found.row]
        centred = replace(cells, center=torch.from_numpy(poses[:, :3, 3]).float())
    return Variance(
        truth=spread(_truth(account.scene, found, cells)),
        centred=spread(_truth(account.scene, found, centred)),
        model=spread(occupied(account, found, cells.points)[0]),
    )


@torch.no_grad()
def occupied(
    account: Account, found: Found, points: Float[Tensor, "frame cell 3"]
) -> tuple[Bool[Tensor, "frame cell"], Float[Tensor, "frame cell 3"]]:
    """Whether the model's field of an object is dense at world points, and its colour there.

    As in the voxel estimate, what lies below the floor or was seen to be free is empty.
    """
    observation, model = account.scene.observation, account.model
    every = points.new_zeros(observation.depth.shape[1], *points.shape[1:])
    every[found.frames] = points
    directions = every - observation.world_from_camera[0, 0, :3, 3]
    decoded = model.decode(account.segmentation.inference, every[None], directions[None], "with")
    assert decoded.colours is not None
    dense = occupancy(decoded.logits[:, :, 1 + found.slot]) > THRESHOLD
    dense &= ~observed_free(rearrange(every, "frame cell xyz -> 1 frame 1 cell xyz"), observation)[:, :, 0]
    dense &= every[None, ..., 2] >= FLOOR
    return dense[0, found.frames], decoded.colours[0, found.frames, 1 + found.slot]


def spread(occupied: Bool[Tensor, "frame cell"]) -> float:
    """Variance over frames of the occupancy, summed over cells, over the mean number of occupied cells.

    0 for what never changes, 1 - 1/frames for what is elsewhere in every frame; nan for what is nowhere.
    """
    mean = occupied.double().mean(dim=0)
    return ((mean * (1 - mean)).sum() / mean.sum()).item()


def code_spread(codes: list[Float[np.ndarray, "_ latent"]]) -> float:
    """Variance of codes over the frames of an object, over that of all codes: 0 if frames agree, 1 if objects do."""
    within = np.mean([code.var(axis=0).sum() for code in codes])
    return float(within / np.concatenate(codes).var(axis=0).sum())


def codes_of(account: Account, found: Found) -> Float[np.ndarray, "frame latent"]:
    """Posterior means of z_what."""
    return account.segmentation.inference.what.mean[0, found.frames, found.slot].detach().numpy()


def _truth(scene: Scene, found: Found, cells: Cells) -> Bool[Tensor, "frame cell"]:
    at_frames = zip(found.frames, cells.points, strict=True)
    return torch.stack([scene.occupied(found.row, frame, points) for frame, points in at_frames])
