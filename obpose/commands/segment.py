"""The command `obpose-segment`: segment RGB-D frames of one static camera.

obpose-segment --rgb a.png --depth a_depth.png --intrinsics 525,525,320,240
obpose-segment --method plane-hdbscan --rgb rgb/ --depth depth/ --intrinsics 525,525,320,240
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from datagen.console.command_line import Command, run_command
from datagen.console.interrupts import interruptible_imports
from datagen.console.text import counted
from obpose.errors import EXIT_OK, UsageError
from obpose.rgbd.frame_arguments import Frames

if TYPE_CHECKING:
    from obpose.rgbd.frames import PreparedFrames, Trained
    from obpose.rgbd.segment import Method

PROGRAM = "obpose-segment"
FindMethod = Callable[[str], "Method"]
"""Function that finds a method without training by name; raises UsageError if there is none."""


@dataclass(frozen=True, kw_only=True)
class Arguments(Frames):
    """Segment RGB-D frames, and find boxes of the objects."""

    checkpoint: Path | None = None
    """Folder of a trained model, or the name of shipped weights; default supervised--desk--128x96, which were
    trained with labels of synthetic scenes."""
    method: str | None = None
    """Name of a method without training, in place of weights: plane-components, plane-dbscan, plane-hdbscan, convexity
    or clip-tracker."""
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
        from obpose.rgbd.frames import prepare_frames
        from obpose.rgbd.results import OBJECTS_FILE, SUMMARY, check_target, write_results
        from obpose.rgbd.segment import segment_frames

    name, method, trained = _method(values, find_method)
    frames = prepare_frames(values, trained)
    check_target(values.out, overwrite=values.overwrite)
    labels = segment_frames(frames, method)
    facts = {
        "method": name,
        "world": frames.world,
        "units": "metres; rotations are world_from_object; size holds the sides of the box",
        "resolution": frames.resolution,
    }
    objects = write_results(values.out, frames, labels, facts, overwrite=values.overwrite)
    print(f"Method: {name}.")
    print(f"World: {frames.world}.")
    print(f"Resolution: {frames.resolution}.")
    _print_objects(frames, [each for each in objects if each][:1])
    print(f"Labels, overlays, boxes and point clouds of {counted(len(labels), 'frame')}: {values.out / OBJECTS_FILE}")
    print(f"Picture: {values.out / SUMMARY}")
    return EXIT_OK


def _method(values: Arguments, find_method: FindMethod) -> "tuple[str, Method, Trained]":
    """Name and function of the chosen method, and what it was trained on."""
    from obpose.rgbd.segment import UNTRAINED
    from obpose.rgbd.weights import DEFAULT, method_of

    if values.method is not None:
        if values.checkpoint is not None:
            raise UsageError("--method and --checkpoint exclude each other; give one of them.")
        return f"{values.method}, without training", find_method(values.method), UNTRAINED
    checkpoint = values.checkpoint or DEFAULT
    return f"weights {checkpoint}", *method_of(checkpoint)


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
