"""Do objects vary less over time in their own frames (paper, figure 2)?

Frames are named as in `PoseConfig.conditioning`: `none` is fixed in the world, `location` follows T_hat, `full` also
rotates with R. Where no model has such a conditioning, the fields of the `full` one are evaluated in such frames.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from pathlib import Path
from statistics import mean
from typing import Literal

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Bool, Float
from torch import Tensor

from benchmark.ranking.leaderboard import Line
from benchmark.studies.inputs import Followed, InferredClip, ModelFlags, TableFlags, infer_clips
from datagen.errors import UsageError
from obpose.geometry import from_box
from obpose.model.nerf.voxels import FLOOR, THRESHOLD, lattice_points, observed_free, occupancy
from obpose.storage.checkpoint import load_obpose
from obpose.storage.pretrained import find_checkpoint

Framing = Literal["none", "location", "full"]
FRAMINGS: tuple[Framing, ...] = ("none", "location", "full")
LEAST_PATH, LEAST_TURN = 0.05, 30.0
"""Metres from which on an object moves, degrees from which on it turns."""


@dataclass(frozen=True, kw_only=True)
class Flags(ModelFlags, TableFlags):
    """Options of the study."""

    other_checkpoints: tuple[str, ...] = ()
    """Folders of models with the conditionings `none` and `location`, beside the one with `full`."""


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
        """Centres of the cells, world frame."""
        lattice = lattice_points(self.resolution, None, self.center)
        return from_box(lattice, self.center, self.rotation, self.size)


def run(flags: Flags) -> Iterator[Line]:
    """Compare variances over objects that move, and over those that turn.

    Raises:
        UsageError: a model has the wrong conditioning.
    """
    flags.check(scenes=1)
    others = [load_obpose(find_checkpoint(Path(name))) for name in flags.other_checkpoints]
    models = {model.config.model.pose.conditioning: model for model in (flags.origin().model, *others)}
    if "full" not in models or not {*models} <= {*FRAMINGS} or len(models) < 1 + len(others):
        raise UsageError(
            f"The conditionings of the models are {', '.join(models)}; expected full, and at most one each of none and "
            "location by --other-checkpoints."
        )
    folder = flags.folder()
    clips = {name: list(infer_clips(model, folder, flags.split, flags.scenes)) for name, model in models.items()}
    for motion, least_path in {"move": LEAST_PATH, "turn": float("inf")}.items():
        for framing in FRAMINGS:
            objects = [
                (clip, followed)
                for clip in clips.get(framing, clips["full"])
                for followed in clip.followed
                if path_length(clip, followed) > least_path
                or clip.turned(followed.row, followed.frames).max() > LEAST_TURN
            ]
            if objects:
                line = {"objects that": motion, "frames": framing, "model": framing if framing in clips else "full"}
                yield {**line, "objects": len(objects), **mean_variances(objects, framing, codes=framing in clips)}


def mean_variances(
    objects: Sequence[tuple[InferredClip, Followed]], framing: Framing, *, codes: bool
) -> dict[str, float]:
    """Average the finite variances over objects; with `codes`, also that of z_what."""
    found = [variances(clip, followed, framing) for clip, followed in objects]
    known = {name: [each[name] for each in found if isfinite(each[name])] for name in found[0]}
    means = {name: mean(values) if values else nan for name, values in known.items()}
    return means | ({"z_what": code_variance([codes_of(*pair) for pair in objects])} if codes else {})


def path_length(clip: InferredClip, followed: Followed) -> float:
    """Largest distance of an object from where it is in the first of its frames, metres."""
    path = clip.truth.world_from_object[followed.frames, followed.row, :3, 3]
    return float(np.linalg.norm(path - path[0], axis=1).max())


def cells_of(clip: InferredClip, followed: Followed, framing: Framing, *, edge: float, cell: float) -> Cells:
    """Lattice of cells of size `cell`: a cube with this edge around an object; for `none`, around its whole path."""
    inference = clip.segmentation.inference
    rotation = torch.eye(3).expand(len(followed.frames), 3, 3)
    if framing == "none":
        path = inference.observed_center[0, followed.frames, followed.slot]
        low, high = path.amin(dim=0), path.amax(dim=0)
        resolution = int(np.ceil(((high - low).max().item() + edge) / cell))
        center = ((low + high) / 2).expand(len(followed.frames), 3)
        return Cells(center, rotation, resolution * cell, resolution)
    if framing == "full":
        rotation = inference.boxes.rotation[0, followed.frames, followed.slot]
    return Cells(inference.boxes.center[0, followed.frames, followed.slot], rotation, edge, round(edge / cell))


def variances(clip: InferredClip, followed: Followed, framing: Framing) -> dict[str, float]:
    """Compute the variances of one object, on voxels of the model's size.

    `truth` is of the generator's shape, in the frames that the model infers. `centred` is the same with the object's
    true origin, which leaves the effect of the orientation. `field` is of the shape of the model's field.
    """
    config = clip.model.config.model
    edge = config.pose.box_size
    cells = cells_of(clip, followed, framing, edge=edge, cell=edge / config.voxels)
    centred = cells
    if framing != "none":
        poses = clip.truth.world_from_object[followed.frames, followed.row]
        centred = replace(cells, center=torch.from_numpy(poses[:, :3, 3]).float())
    occupied = {
        "truth": _true_occupancy(clip, followed, cells),
        "centred": _true_occupancy(clip, followed, centred),
        "field": field_occupancy(clip, followed, cells.points),
    }
    return {name: occupancy_variance(values) for name, values in occupied.items()}


@torch.no_grad()
def field_occupancy(
    clip: InferredClip, followed: Followed, points: Float[Tensor, "frame cell 3"]
) -> Bool[Tensor, "frame cell"]:
    """Evaluate whether an object's field is dense at world points.

    As in the voxel estimate, points below the floor and points observed to be free are empty.
    """
    observation, model = clip.observation, clip.model
    every = points.new_zeros(observation.depth.shape[1], *points.shape[1:])
    every[followed.frames] = points
    directions = every - observation.world_from_camera[0, 0, :3, 3]
    decoded = model.decode(clip.segmentation.inference, every[None], directions[None], "with")
    dense = occupancy(decoded.logits[:, :, 1 + followed.slot]) > THRESHOLD
    dense &= ~observed_free(rearrange(every, "frame cell xyz -> 1 frame 1 cell xyz"), observation)[:, :, 0]
    dense &= every[None, ..., 2] >= FLOOR
    return dense[0, followed.frames]


def occupancy_variance(occupied: Bool[Tensor, "frame cell"]) -> float:
    """Variance over frames of the occupancy, summed over cells, divided by the mean number of occupied cells.

    0 for a shape that never changes, 1 - 1/frames for one that is elsewhere in every frame, nan for an empty one.
    """
    average = occupied.double().mean(dim=0)
    return ((average * (1 - average)).sum() / average.sum()).item()


def code_variance(codes: list[Float[np.ndarray, "_ latent"]]) -> float:
    """Mean variance of codes over an object's frames, divided by the variance of all codes.

    0 if an object's codes agree in all frames, 1 if all objects have equal means.
    """
    within = np.mean([code.var(axis=0).sum() for code in codes])
    return float(within / np.concatenate(codes).var(axis=0).sum())


def codes_of(clip: InferredClip, followed: Followed) -> Float[np.ndarray, "frame latent"]:
    """Posterior means of an object's z_what."""
    return clip.segmentation.inference.what.mean[0, followed.frames, followed.slot].detach().numpy()


def _true_occupancy(clip: InferredClip, followed: Followed, cells: Cells) -> Bool[Tensor, "frame cell"]:
    at_frames = zip(followed.frames, cells.points, strict=True)
    return torch.stack([clip.occupied(followed.row, frame, points) for frame, points in at_frames])
