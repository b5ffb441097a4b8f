"""The command `obpose-segment`: segment RGB-D frames of one static camera with a trained model.

obpose-segment --checkpoint RUN --rgb a.png --depth a_depth.png --intrinsics 525,525,320,240
obpose-segment --checkpoint obpose--moving--64x64 --rgb rgb/ --depth depth/ --intrinsics 525,525,320,240 --every 8
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from einops import rearrange
from jaxtyping import Int

from datagen.console.command_line import Command, run_command
from datagen.console.text import counted
from datagen.storage.atomic import check_new_folder
from obpose.data.resolution import fitting_model
from obpose.errors import EXIT_OK
from obpose.rgbd.frames import Frames, prepare_frames
from obpose.rgbd.results import SegmentedObject, write_results
from obpose.storage.checkpoint import load_obpose
from obpose.storage.pretrained import find_checkpoint
from obpose.types import SceneSegmentation, Segmentation

PROGRAM = "obpose-segment"


@dataclass(frozen=True, kw_only=True)
class Arguments(Frames):
    """Segment RGB-D frames, and infer positions and rotations of the objects."""

    checkpoint: Path
    """Folder of a trained model, or the name of shipped weights."""
    out: Path = Path("segmented")
    """Folder for label images, overlays, and objects.json."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Segment and return the exit code."""
    return run_command(
        PROGRAM,
        Command(Arguments, run),
        description=__doc__,
        arguments=arguments,
        out_of_memory="Out of memory; give fewer frames at a time, or a larger --every.",
    )


def run(values: Arguments) -> int:
    """Segment the frames and write all files."""
    model = load_obpose(find_checkpoint(values.checkpoint))
    frames = prepare_frames(values, model)
    check_new_folder(values.out)
    segmentation = fitting_model(model, frames.observation).segment(frames.observation)
    labels = _enlarged(segmentation, values.every, frames.recording.depth.shape)
    facts = {
        "checkpoint": str(values.checkpoint),
        "world": frames.world,
        "units": "metres; rotations are world_from_object; box_size is the edge of the object's cube",
        "resolution": frames.resolution,
    }
    objects = _objects(segmentation, labels)
    page = write_results(values.out, frames.recording, labels, objects, frames.pose, facts)
    print(f"World: {frames.world}.")
    print(f"Resolution: {frames.resolution}.")
    print(f"Labels, overlays and poses of {counted(len(labels), 'frame')}: {page}")
    return EXIT_OK


def _enlarged(segmentation: Segmentation, step: int, shape: tuple[int, ...]) -> Int[np.ndarray, "frame height width"]:
    """Labels in full resolution: each square of pixels gets the label of the pixel that was used."""
    labels = rearrange(segmentation.labels, "1 frame 1 h w -> frame h w").numpy()
    rows = np.minimum(np.arange(shape[1]) // step, labels.shape[1] - 1)
    columns = np.minimum(np.arange(shape[2]) // step, labels.shape[2] - 1)
    return labels[:, rows[:, None], columns]


def _objects(
    segmentation: SceneSegmentation, labels: Int[np.ndarray, "frame height width"]
) -> list[list[SegmentedObject]]:
    """Objects of each frame: all active slots, visible or not."""
    inference = segmentation.inference
    has_boxes = inference.where is not None
    center, rotation = (
        values[0].detach().cpu().numpy().astype(np.float64)
        for values in (inference.boxes.center if has_boxes else inference.observed_center, inference.boxes.rotation)
    )
    slots = [slot for slot in range(center.shape[1]) if inference.masks.active[0, slot]]
    return [
        [
            SegmentedObject(
                label=slot + 1,
                pixels=int(np.sum(labels[frame] == slot + 1)),
                center=center[frame, slot],
                rotation=rotation[frame, slot],
                box_size=inference.boxes.size if has_boxes else None,
            )
            for slot in slots
        ]
        for frame in range(len(labels))
    ]


if __name__ == "__main__":
    sys.exit(main())
