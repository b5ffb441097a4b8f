"""The poses that ObPose infers, as the benchmark scores them."""

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Float, Int

from benchmark.models.interface import Poses
from obpose.geometry import unproject
from obpose.model.obpose import ObPose
from obpose.trainable import Trainable
from obpose.types import Boxes, Observation, SceneSegmentation, Segmentation


def poses_of(model: Trainable, found: Segmentation, observation: Observation) -> Poses | None:
    """Poses of the objects behind a segmentation's labels, label 0 being the background; None where a model has none.

    Scenes of the batch are views of one clip. The place is T_hat, the orientation R. The model's own box is a cube of
    one size for all objects; theirs is the smallest box around T_hat, along R, that holds the surface points of the
    label: what is seen on one side of the middle, the object is taken to reach on the other.
    """
    if not isinstance(model, ObPose) or not isinstance(found, SceneSegmentation) or found.inference.where is None:
        return None
    boxes = found.inference.boxes
    reach = _reach(boxes, found.labels, unproject(observation))
    there = reach.isfinite().all(dim=-1)
    values = (
        boxes.center.masked_fill(~there[..., None], torch.nan),
        boxes.rotation.masked_fill(~there[..., None, None], torch.nan),
        2 * reach.masked_fill(~there[..., None], torch.nan),
    )
    return Poses(*(_with_background(value) for value in values))


def _reach(
    boxes: Boxes,
    labels: Int[torch.Tensor, "view frame 1 height width"],
    points: Float[torch.Tensor, "view frame 1 height width 3"],
) -> Float[torch.Tensor, "view frame slot 3"]:
    """How far the points of each label lie from the middle of its box, along the box's axes; -inf without points."""
    flat, owner = (rearrange(array, "v f 1 h w ... -> v f (h w) ...") for array in (points, labels))
    reaches = []
    for slot in range(boxes.center.shape[2]):
        local = torch.einsum("vfpi,vfij->vfpj", flat - boxes.center[:, :, slot, None], boxes.rotation[:, :, slot])
        mine = (owner == slot + 1)[..., None]
        reaches.append(local.abs().masked_fill(~mine, -torch.inf).amax(dim=2))
    return torch.stack(reaches, dim=2)


def _with_background(
    values: Float[torch.Tensor, "view frame slot *shape"],
) -> Float[np.ndarray, "frame view label *shape"]:
    array = rearrange(values, "view frame ... -> frame view ...").double().cpu().numpy()
    return np.concatenate([np.full_like(array[:, :, :1], np.nan), array], axis=2)
