"""Do objects vary less over time in their own frames (paper, figure 2)?

Frames are named as in `PoseConfig.conditioning`: `none` is fixed in the world, `location` follows T_hat, `full` also
rotates with R. Where no model has such a conditioning, the fields of the `full` one are evaluated in such frames.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from pathlib import Path
from statistics import mean
from typing import Literal

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Bool, Float
from PIL import Image
from torch import Tensor

from benchmark.ranking.leaderboard import Line
from benchmark.studies.drawing import GREY, SIDE, Cubes, draw, first_to_last, look_at, sheet, wire_box
from benchmark.studies.inputs import Followed, InferredClip, ModelFlags, TableFlags, infer_clips
from datagen.errors import UsageError
from obpose.geometry import from_box
from obpose.model.nerf.voxels import FLOOR, THRESHOLD, lattice_points, observed_free, occupancy
from obpose.scenes.clip import one_of
from obpose.scenes.pictures import write_png
from obpose.storage.checkpoint import load_obpose
from obpose.storage.pretrained import find_checkpoint

Framing = Literal["none", "location", "full"]
FRAMINGS: tuple[Framing, ...] = ("none", "location", "full")
LEAST_PATH, LEAST_TURN = 0.05, 30.0
"""Metres from which on an object moves, degrees from which on it turns."""
FINE = 24
"""Voxels along a box in the picture."""


@dataclass(frozen=True, kw_only=True)
class Flags(ModelFlags, TableFlags):
    """Options of the study."""

    other_checkpoints: tuple[str, ...] = ()
    """Folders of models with the conditionings `none` and `location`, beside the one with `full`."""
    picture: Path | None = None
    """PNG for figure 2 of the paper."""
    figure_scene: int = 0
    """Scene in the picture, which shows the object that turns most."""


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
    """Compare variances over objects that move, and over those that turn; draw the picture."""
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
    shown = one_of("--figure-scene", flags.figure_scene, len(clips["full"]))
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
    if flags.picture is not None:
        turning = turning_most({framing: clips.get(framing, clips["full"])[shown] for framing in FRAMINGS})
        write_png(flags.picture, np.asarray(draw_frames(turning, resolution=FINE)))


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
        "field": field_occupancy(clip, followed, cells.points)[0],
    }
    return {name: occupancy_variance(values) for name, values in occupied.items()}


@torch.no_grad()
def field_occupancy(
    clip: InferredClip, followed: Followed, points: Float[Tensor, "frame cell 3"]
) -> tuple[Bool[Tensor, "frame cell"], Float[Tensor, "frame cell 3"]]:
    """Evaluate an object's field at world points: whether it is dense there, and its colour.

    As in the voxel estimate, points below the floor and points observed to be free are empty.
    """
    observation, model = clip.observation, clip.model
    every = points.new_zeros(observation.depth.shape[1], *points.shape[1:])
    every[followed.frames] = points
    directions = every - observation.world_from_camera[0, 0, :3, 3]
    decoded = model.decode(clip.segmentation.inference, every[None], directions[None], "with")
    assert decoded.colours is not None
    dense = occupancy(decoded.logits[:, :, 1 + followed.slot]) > THRESHOLD
    dense &= ~observed_free(rearrange(every, "frame cell xyz -> 1 frame 1 cell xyz"), observation)[:, :, 0]
    dense &= every[None, ..., 2] >= FLOOR
    return dense[0, followed.frames], decoded.colours[0, followed.frames, 1 + followed.slot]


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


def turning_most(clips: Mapping[Framing, InferredClip]) -> dict[Framing, tuple[InferredClip, Followed]]:
    """Choose the object that turns most among those that all models follow, in the frames they have in common."""
    followed = [{each.row: each for each in clips[framing].followed} for framing in FRAMINGS]
    common: dict[int, list[int]] = {}
    for row in set.intersection(*map(set, followed)):
        if frames := set.intersection(*(set(rows[row].frames) for rows in followed)):
            common[row] = sorted(frames)
    if not common:
        raise UsageError("No object of this scene is followed by a slot of every model; choose another --figure-scene.")
    row = max(common, key=lambda row: clips["full"].turned(row, common[row]).max())
    return {
        framing: (clips[framing], replace(rows[row], frames=common[row]))
        for framing, rows in zip(FRAMINGS, followed, strict=True)
    }


def draw_frames(objects: Mapping[Framing, tuple[InferredClip, Followed]], *, resolution: int) -> Image.Image:
    """Draw figure 2: an object's field in its own frame over time, and how often each voxel is occupied there."""
    rows, titles = {}, []
    for framing in FRAMINGS:
        clip, followed = objects[framing]
        edge = clip.model.config.model.pose.box_size
        cells = cells_of(clip, followed, framing, edge=edge, cell=edge / resolution)
        dense, colours = field_occupancy(clip, followed, cells.points)
        shown = first_to_last(len(followed.frames))
        share = dense.float().mean(dim=0)
        tiles = [_draw_lattice(cells, dense[place].float(), colours[place]) for place in shown]
        tiles.append(_draw_lattice(cells, share, torch.tensor([0.1, 0.2, 0.5]).expand(len(share), 3)))
        rows[framing.replace("full", "location\nand rotation")] = tiles
        titles = [*(f"frame {followed.frames[place]}" for place in shown), "share of frames"]
    return sheet(titles, rows)


def _draw_lattice(cells: Cells, opacity: Float[Tensor, " cell"], colours: Float[Tensor, "cell 3"]) -> Image.Image:
    """Draw the lattice at rest."""
    points = Cells(torch.zeros(1, 3), torch.eye(3)[None], cells.size, cells.resolution).points[0]
    shown = opacity > 0
    edge = cells.size / cells.resolution
    cubes = Cubes(points[shown].numpy(), np.eye(3), edge, colours[shown].numpy(), opacity[shown].numpy())
    eye = look_at(np.zeros(3), SIDE, distance=4 * cells.size, focal=2.3)
    return draw([cubes], eye, below=wire_box(np.zeros(3), np.eye(3), np.full(3, cells.size / 2), GREY))


def _true_occupancy(clip: InferredClip, followed: Followed, cells: Cells) -> Bool[Tensor, "frame cell"]:
    at_frames = zip(followed.frames, cells.points, strict=True)
    return torch.stack([clip.occupied(followed.row, frame, points) for frame, points in at_frames])
