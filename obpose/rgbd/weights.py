"""Weights as a method to segment a user's frames, and to give masks to a model with fields."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Int
from torch import Tensor

from obpose.contact.model import ContactModel
from obpose.contact.scene_model import ContactObPose
from obpose.errors import UsageError
from obpose.model.attention.icsbp import ICSBP
from obpose.model.obpose import ObPose
from obpose.model.resolution import fitting_model
from obpose.rgbd.frame_arguments import Frames
from obpose.rgbd.frames import PreparedFrames, Trained, prepare, trained_on
from obpose.rgbd.segment import Labels, Method, segment_frames
from obpose.storage.checkpoint import load
from obpose.storage.pretrained import find_checkpoint
from obpose.trainable import Trainable
from obpose.types import Observation

DEFAULT = "supervised--desk--128x96"
"""Name of the shipped weights for frames of a user's own."""


def method_of(
    checkpoint: str | Path, objects: int | None = None, *, option: str = "--checkpoint"
) -> tuple[Method, Trained]:
    """Load weights that an option names as a method, and describe the scenes that they were trained on.

    The IC-SBP of ObPose looks for `objects` objects, by default for as many as in training; other weights have no
    limit.

    Raises:
        UsageError: there are none, or their system cannot segment frames of a user.
        CorruptFile: a file is damaged.
    """
    model, config, _ = load(find_checkpoint(Path(checkpoint), option=option))
    if objects is not None:
        look_for(model, objects)
    masks = _masks_alone(model)
    if isinstance(masks, ContactModel):
        # The world of the frames has its table at z = 0, wherever that of the training was.
        masks.config = replace(masks.config, model=replace(masks.config.model, table=0.0))
    return partial(_segment, model), trained_on(config)


def look_for(model: Trainable, objects: int) -> None:
    """Set the number of objects that the IC-SBP of ObPose looks for; other models have no such limit."""
    if isinstance(model, ObPose) and isinstance(model.attention, ICSBP):
        model.attention.slots = objects


def segment_reduced(checkpoint: str, flags: Frames, frames: PreparedFrames) -> Int[Tensor, "1 frame 1 height width"]:
    """Label prepared frames by weights that need another resolution, and which `--masks` names.

    Args:
        checkpoint: Folder or name of the weights.
        flags: Flags of the frames.
        frames: The same frames, prepared for another model.

    Raises:
        UsageError: as `method_of`.
    """
    method, trained = method_of(checkpoint, option="--masks")
    labels = torch.from_numpy(segment_frames(prepare(frames.recording, flags, trained), method)).long()
    start = frames.every // 2
    return labels[None, :, None, start :: frames.every, start :: frames.every]


def segment_clip(checkpoint: str, clip: Observation) -> Int[Tensor, "1 frame view height width"]:
    """Label a clip of a dataset by weights of the contact model, which `--masks` names.

    Raises:
        UsageError: as `method_of`, or the weights are of another system.
    """
    model = _masks_alone(load(find_checkpoint(Path(checkpoint), option="--masks"))[0])
    if not isinstance(model, ContactModel):
        raise UsageError(f"--masks {checkpoint}: expected weights of obpose-contact, contact-masks, supervised or ogc.")
    return model.label_objects(clip)


def _segment(model: Trainable, observation: Observation) -> Labels:
    model = _masks_alone(model)
    fitting = fitting_model(model, observation) if isinstance(model, ObPose) else model
    return fitting.segment(observation).labels[0, :, 0].cpu().numpy()


def _masks_alone(model: Trainable) -> Trainable:
    """Leave out the encoders and fields of objects where masks do not depend on them."""
    return model.contact if isinstance(model, ContactObPose) else model
