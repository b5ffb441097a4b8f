"""Poses inferred by ObPose, in the form that the benchmark scores."""

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
    """Poses of the objects in a segmentation; None if the model has no poses. Label 0 is the background.

    Scenes of the batch are views of one clip. The center is T_hat, the rotation is R. The model's own boxes are cubes
    of one size, so boxes are measured: the smallest box, centred at T_hat and along R, around the label's surface
    points. Objects are thus assumed symmetric about T_hat.
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
    """Largest distances of each label's points from its box's centre, along the box's axes; -inf without points."""
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
