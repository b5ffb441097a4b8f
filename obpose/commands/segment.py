"""The command `obpose-segment`: segment RGB-D frames of a table.

obpose-segment recording/
obpose-segment --rgb a.png --depth a_depth.png --intrinsics 525,525,320,240
obpose-segment recording/ --video
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from datagen.console.command_line import Command, run_command
from datagen.console.interrupts import interruptible_imports
from datagen.console.text import counted
from datagen.rgbd import OBJECTS
from obpose.errors import EXIT_OK, UsageError
from obpose.rgbd.frame_arguments import Frames

if TYPE_CHECKING:
    from obpose.rgbd.frames import PreparedFrames
    from obpose.rgbd.segment import Method
    from obpose.rgbd.world import World

PROGRAM = "obpose-segment"
FindMethod = Callable[[str, int], "Method"]
"""Function that finds a method without training by name, for at most a number of objects; or raises UsageError."""
AUTO = "auto"
UNTRAINED_CHOICE = "plane-hdbscan"
FARTHEST, LOWEST = 2.6, 21.0
"""Greatest distance (metres) and least elevation (degrees) of cameras for which `auto` takes the weights. Those
of their training images are 0.4 to 1.3 m and 25 to 85 degrees; docs/own_frames.md compares methods beyond."""


@dataclass(frozen=True, kw_only=True)
class Arguments(Frames):
    """Segment RGB-D frames, and find boxes of the objects."""

    checkpoint: Path | None = None
    """Folder of a trained model, or the name of shipped weights, in place of --method."""
    method: str = AUTO
    """`auto`, which says what it chose, or a method without training: plane-components, plane-dbscan, plane-hdbscan,
    convexity, clip-tracker, plane-dbscan-colour, plane-dbscan-tracked or kmeans-xyz-rgb."""
    objects: int | None = None
    """Most objects, the largest ones first. Default: as many as there are, up to 16."""
    video: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """The frames are a video, in which objects, and with known poses the camera, may move: each frame is segmented on
    its own, and objects keep their labels over time."""
    out: Path = Path("segmented")
    """Folder for label images, overlays, point clouds and objects.json."""
    overwrite: bool = False
    """Replace an earlier result in the folder."""


def main(arguments: Sequence[str] | None = None, *, find_method: FindMethod) -> int:
    """Segment and return the exit code; `find_method` finds methods without training."""
    return run_command(
        PROGRAM,
        Command(Arguments, partial(run, find_method=find_method)),
        description=__doc__,
        arguments=arguments,
        out_of_memory="Out of memory; give fewer frames at a time, or a larger --every.",
    )


def run(values: Arguments, *, find_method: FindMethod) -> int:
    """Segment the frames and write all files."""
    # Late, because PyTorch takes seconds to import.
    with interruptible_imports(PROGRAM):
        from obpose.contact.clip import MOST_OBJECTS
        from obpose.rgbd.results import OBJECTS_FILE, SUMMARY, check_target, objects_of, width_warnings, write_results
        from obpose.rgbd.segment import segment_frames

    if values.objects is not None and not 1 <= values.objects <= MOST_OBJECTS:
        raise UsageError(f"--objects {values.objects}: expected 1 to {MOST_OBJECTS}.")
    most = values.objects or OBJECTS
    name, method, frames = _prepared(values, find_method, most)
    if frames.moves and not values.video:
        raise UsageError("The camera moves, and only --video follows objects through its frames; add --video.")
    check_target(values.out, overwrite=values.overwrite)
    labels = segment_frames(frames, method, video=values.video, most=most)
    warnings = list(frames.warnings)
    if labels.max() == most:
        warnings.append(f"As many objects were found as were looked for, {most}: there may be more; see --objects.")
    objects = [objects_of(image, frames.points(number)) for number, image in enumerate(labels)]
    warnings += width_warnings(objects)
    facts = {
        "method": name,
        "world": frames.world.note,
        "camera": frames.world.camera,
        "warnings": warnings,
        "units": "metres; rotations are world_from_object; size holds the sides of the box",
        "resolution": frames.resolution,
    }
    write_results(values.out, frames, labels, objects, facts, overwrite=values.overwrite)
    print(f"Method: {name}.")
    print(f"World: {frames.world.note}.")
    print(f"Camera: {frames.world.camera}.")
    print(f"Resolution: {frames.resolution}.")
    for warning in warnings:
        print(f"Warning: {warning}")
    if frames.recording.left_out:
        print(f"{counted(frames.recording.left_out, 'image')} without depth or pose at their time left out.")
    _print_objects(frames, [each for each in objects if each][:1])
    print(f"Labels, overlays, boxes and point clouds of {counted(len(labels), 'frame')}: {values.out / OBJECTS_FILE}")
    print(f"Picture: {values.out / SUMMARY}")
    return EXIT_OK


def _prepared(values: Arguments, find_method: FindMethod, most: int) -> "tuple[str, Method, PreparedFrames]":
    """Name and function of the chosen method, and the frames as it needs them."""
    from obpose.rgbd.frames import prepare
    from obpose.rgbd.reading import read_frames
    from obpose.rgbd.segment import UNTRAINED
    from obpose.rgbd.weights import DEFAULT, method_of

    if values.method != AUTO and values.checkpoint is not None:
        raise UsageError("--method and --checkpoint exclude each other; give one of them.")
    recording = read_frames(values)
    if values.method == AUTO and values.checkpoint is None:
        method, trained = method_of(DEFAULT, most)
        frames = prepare(recording, values, trained)
        if not (unlike := _unlike_training(frames.world)):
            name = (
                f"weights {DEFAULT}, chosen because the camera is at most {FARTHEST:g} m away and at least {LOWEST:g} "
                "degrees above the table"
            )
            return name, method, frames
        name = f"{UNTRAINED_CHOICE}, without training, chosen because {unlike} the weights were trained for"
        return name, find_method(UNTRAINED_CHOICE, most), prepare(recording, values, UNTRAINED)
    if values.method != AUTO:
        method = find_method(values.method, most)
        return f"{values.method}, without training", method, prepare(recording, values, UNTRAINED)
    assert values.checkpoint is not None
    method, trained = method_of(values.checkpoint, most)
    return f"weights {values.checkpoint}", method, prepare(recording, values, trained)


def _unlike_training(world: "World") -> str:
    """Say how the first camera differs from those of the training; empty if it does not."""
    distance = math.dist(world.poses[0, :3, 3], (0, 0, 0))
    elevation = math.degrees(math.asin(min(1.0, float(world.poses[0, 2, 3]) / distance)))
    if distance > FARTHEST:
        return f"the camera is {distance:.1f} m away, farther than"
    return f"the camera is {elevation:.0f} degrees above the table, lower than" if elevation < LOWEST else ""


def _print_objects(frames: "PreparedFrames", objects: list) -> None:
    """Print the objects of the first frame that has any."""
    if not objects:
        print("No object was found: is the white outline in the picture that of your table? See docs/own_frames.md.")
        return
    print("Object   pixels   sides (cm)          centre x, y, z (m)")
    for each in objects[0]:
        sides = " x ".join(f"{100 * side:.1f}" for side in each.box.size)
        center = ", ".join(f"{value:.3f}" for value in each.box.center)
        print(f"{each.label:6d} {each.pixels:8d}   {sides:18}  {center}")
