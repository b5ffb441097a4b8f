"""The command `obpose-segment`: a trained model on a user's own RGB-D frames of one camera that stands still.

obpose-segment --checkpoint RUN --rgb a.png --depth a_depth.png --intrinsics 525,525,320,240
obpose-segment --checkpoint obpose--moving--64x64 --rgb rgb/ --depth depth/ --intrinsics 525,525,320,240 --every 8
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from einops import rearrange
from jaxtyping import Float, Float64, Int

from obpose.checkpoint import load_obpose
from obpose.errors import EXIT_OK, UsageError, run_program
from obpose.geometry import unproject
from obpose.model import ObPose
from obpose.recordings.reading import Recording, parse_intrinsics, read_recording
from obpose.recordings.world import FITTED, GIVEN, Pose, middle_of, pose_over_plane, read_pose
from obpose.recordings.writing import Found, write_results
from obpose.resolution import fitting_model, surface_spacing
from obpose.shipped import find_checkpoint
from obpose.types import Observation, SceneSegmentation, Segmentation

PROGRAM = "obpose-segment"


@dataclass(frozen=True)
class Arguments:
    """Segment RGB-D frames, and find where the objects are and how they are turned."""

    checkpoint: Path
    """Folder of a trained model, or the name of weights that ship with this package."""
    rgb: tuple[Path, ...]
    """Colour images in time order, or one folder of them."""
    depth: tuple[Path, ...]
    """Depth images, aligned with them, or one folder: PNG or TIFF of 16 bits, or TIFF or NPY of floats in metres."""
    intrinsics: str
    """fx,fy,cx,cy in pixels; the centre of the first pixel is at 0.5, 0.5, so add 0.5 to OpenCV's cx and cy."""
    camera_pose: Path | None = None
    """File with world_from_camera, 4x4, metres, as text, JSON or NPY: camera axes x right, y down, z forward, world z
    up from the table at z = 0. If left out, the world stands on the largest plane in view."""
    depth_scale: float = 0.001
    """Metres of one unit of depth images of whole numbers."""
    every: int = 1
    """Take one pixel of each square of so many, such that a pixel shows about as much of the table as in training."""
    out: Path = Path("segmented")
    """Folder for label images, overlays, and objects.json."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the console script; leaves with an exit code of `obpose.errors`."""
    description = "\n\n".join(filter(None, (__doc__ or "").split("\n")))
    code = run_program(
        PROGRAM,
        lambda: run(tyro.cli(Arguments, prog=PROGRAM, args=arguments, description=description)),
        out_of_memory="Out of memory; give fewer frames at a time, or a larger --every.",
    )
    sys.exit(code)


def run(values: Arguments) -> int:
    """Segment and write."""
    if not 0 < values.depth_scale < math.inf:
        raise UsageError(f"--depth-scale is {values.depth_scale:g}; expected more than 0, and finite.")
    k = parse_intrinsics(values.intrinsics)
    model = load_obpose(find_checkpoint(values.checkpoint))
    whole = read_recording(values.rgb, values.depth, k, depth_scale=values.depth_scale)
    recording = whole.every(values.every)
    pose = read_pose(values.camera_pose) if values.camera_pose else _pose_over_plane(recording, model)
    observation = _observation(recording, pose)
    note = _resolution_note(model, observation)
    found = fitting_model(model, observation).segment(observation)
    labels = _enlarged(found, values.every, whole.depth.shape)
    facts = {
        "checkpoint": str(values.checkpoint),
        "world": _given_note(observation, model) if values.camera_pose else FITTED,
        "units": "metres; rotations are world_from_object; box_size is the edge of the object's cube",
        "resolution": note,
    }
    page = write_results(values.out, whole, labels, _objects(found, labels, model), pose, facts)
    print(f"World: {facts['world']}.")
    print(f"Resolution: {note}.")
    print(f"Labels, overlays and poses of {len(labels)} frames: {page}")
    return EXIT_OK


def _observation(recording: Recording, pose: Pose) -> Observation:
    depth = rearrange(torch.from_numpy(recording.depth), "frame h w -> 1 frame 1 h w")
    return Observation(
        rgb=rearrange(torch.from_numpy(recording.rgb), "frame h w c -> 1 frame 1 h w c").to(torch.float32) / 255,
        depth=depth,
        valid=depth > 0,
        k=torch.from_numpy(recording.k).to(torch.float32)[None, None],
        world_from_camera=torch.from_numpy(pose).to(torch.float32)[None, None],
    )


def _pose_over_plane(recording: Recording, model: ObPose) -> Pose:
    seen = _first_points(_observation(recording, np.eye(4)))
    return pose_over_plane(seen, center=model.config.model.workspace_center)


def _given_note(observation: Observation, model: ObPose) -> str:
    """Whether the given world is one that the model knows."""
    points, trained = _first_points(observation), model.config.model
    away = float(np.linalg.norm(middle_of(points) - trained.workspace_center)) if len(points) else 0.0
    if away < trained.workspace_size / 2:
        return GIVEN
    x, y, z = trained.workspace_center
    return (
        f"{GIVEN}; what is in view lies {away:.2f} m from ({x:.2f}, {y:.2f}, {z:.2f}), around which the model was "
        "trained: results may be poor, move the world's origin there"
    )


def _first_points(observation: Observation) -> Float64[np.ndarray, "point 3"]:
    """What the first frame shows, metres."""
    return unproject(observation)[0, 0][observation.valid[0, 0]].numpy().astype(np.float64)


def _resolution_note(model: ObPose, observation: Observation) -> str:
    """How the frames compare to those of the training."""
    trained, spacing = model.config.model.spacing, surface_spacing(observation)
    if spacing is None:
        return "no neighbouring pixels have a depth"
    words = (
        f"neighbouring pixels are {1000 * spacing:.1f} mm apart on the surfaces, in training {1000 * trained:.1f} mm"
    )
    if fitting_model(model, observation) is model:
        return words
    step = round(trained / spacing)
    hint = f"; --every {step} comes near to it" if step > 1 else ""
    return f"{words}: the model was not trained for this and its neighbourhoods were scaled{hint}"


def _enlarged(found: Segmentation, step: int, shape: tuple[int, ...]) -> Int[np.ndarray, "frame height width"]:
    """Labels of all pixels of the recording: squares have the label of the pixel that was taken."""
    labels = rearrange(found.labels, "1 frame 1 h w -> frame h w").numpy()
    rows = np.minimum(np.arange(shape[1]) // step, labels.shape[1] - 1)
    columns = np.minimum(np.arange(shape[2]) // step, labels.shape[2] - 1)
    return labels[:, rows[:, None], columns]


def _objects(
    found: SceneSegmentation, labels: Int[np.ndarray, "frame height width"], model: ObPose
) -> list[list[Found]]:
    """The objects of each frame: slots in use, whether they are in view or not."""
    inference = found.inference
    boxed = inference.where is not None
    center = _array(inference.boxes.center if boxed else inference.observed_center)
    rotation = _array(inference.boxes.rotation)
    slots = [slot for slot in range(center.shape[1]) if inference.masks.active[0, slot]]
    return [
        [
            Found(
                label=slot + 1,
                pixels=int(np.sum(labels[frame] == slot + 1)),
                center=center[frame, slot],
                rotation=rotation[frame, slot],
                box_size=inference.boxes.size if boxed else None,
            )
            for slot in slots
        ]
        for frame in range(len(labels))
    ]


def _array(values: Float[torch.Tensor, "1 frame slot ..."]) -> Float[np.ndarray, "frame slot ..."]:
    return values[0].detach().cpu().numpy().astype(np.float64)


if __name__ == "__main__":
    main()
