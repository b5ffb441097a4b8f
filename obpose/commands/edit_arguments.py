"""The command `obpose-edit`: infer, sample, change and render scenes of a trained model.

obpose-edit infer --data DIR --out a                                              what is in test scene 0
obpose-edit infer FRAMES --out a                                                  what is in frames of your own
obpose-edit sample --checkpoint obpose-contact--moving--64x64 --out b             a new scene
obpose-edit move a --object 2 --by 0.1,0,0 --out c                                add, remove, rotate and swap likewise
obpose-edit render c --turntable 24 --out turn.gif
obpose-edit mesh c --object 2 --out object.glb
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from datagen.console.command_line import Command, run_command
from obpose.rgbd.frame_arguments import Frames

PROGRAM = "obpose-edit"

Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]
SceneFolder = Annotated[Path, tyro.conf.Positional]


@dataclass(frozen=True, kw_only=True)
class _Shown:
    """Options of commands that write a scene with a picture."""

    out: Path
    """Folder for the scene and its picture; it must be empty or not exist."""
    resolution: str | None = None
    """Width x height of the picture, such as 128x128; default the camera's."""


@dataclass(frozen=True, kw_only=True)
class _OfScene:
    """Options of commands that read a scene."""

    scene: SceneFolder
    """Folder of a scene."""
    checkpoint: str | None = None
    """Folder of the model, or the name of weights that ship with this package; default the place in the scene."""


@dataclass(frozen=True, kw_only=True)
class _OfObject:
    """Option of commands about one object."""

    object: int
    """Name of the object, as printed."""


@dataclass(frozen=True, kw_only=True)
class _Placed:
    """Options of commands that place an object."""

    by: str | None = None
    """Displacement x,y,z in metres, world frame, such as 0.1,0,0."""
    to: str | None = None
    """Position x,y,z of the centre of its box in the first frame, metres."""


@dataclass(frozen=True, kw_only=True)
class Infer(Frames, _Shown):
    """Infer a scene from a clip of a dataset, or from RGB-D frames of your own."""

    checkpoint: str | None = None
    """Folder of a trained model, or the name of weights that ship with this package. Default: those of
    obpose-contact that were trained on the recipe of the dataset, and on `moving` for frames of your own."""
    data: Path | None = None
    """Folder of a dataset, instead of frames."""
    split: Literal["train", "val", "test"] = "test"
    scene: int = 0
    """Index of the scene in the split."""
    masks: str | None = None
    """Weights of obpose-contact, contact-masks, supervised or ogc, a folder or a shipped name, that find the objects;
    `own`: the model finds them. Default: supervised--desk--128x96 for frames of your own, the model for clips of a
    dataset."""
    refine: int = 100
    """Steps in which the scene is fitted to the frames, which takes seconds; 0: codes as inferred, without details."""


@dataclass(frozen=True, kw_only=True)
class Sample(_Shown):
    """Sample a new scene."""

    checkpoint: str
    """Folder of a trained model, or the name of weights that ship with this package."""
    camera: Path | None = None
    """Folder of a scene whose cameras are used. Default: the camera of the recipe `moving`, about a metre from
    the origin, which it looks down at by 55 degrees, with 128x128 pixels."""
    objects: int = 3
    """Number of objects."""
    seed: int = 0
    """Random seed."""
    prior: Literal["flow", "gaussian", "learned"] | None = None
    """`flow`: whole objects with details; `gaussian`: mixtures of Gaussians of inferred codes; `learned`: the priors
    that the model learned. `obpose-edit fit-prior` makes the first two. Default: the first of these that the weights
    have."""


@dataclass(frozen=True)
class FitPrior:
    """Fit a prior to sample scenes from, beside a model's weights.

    An interrupted training of a flow is resumed by the same command.
    """

    checkpoint: str
    """Folder of a trained model; for a flow it needs a Gaussian prior."""
    data: Path
    """Folder of the dataset that it was trained on."""
    kind: Literal["gaussian", "flow"] = "gaussian"
    """`gaussian`: mixtures of Gaussians of inferred codes; `flow`: a flow that samples whole objects with details."""
    clips: int | None = None
    """Number of training clips; default 500 for `gaussian`, 400 for `flow`, which takes some seconds for each."""
    steps: int = 3000
    """Training steps of a flow, about a tenth of a second each."""
    seed: int = 0
    """Seed of the training of a flow."""
    workers: int | None = None
    """Number of processes that look for objects for a flow; default one per core."""


@dataclass(frozen=True, kw_only=True)
class Render(_OfScene):
    """Render a scene from one of its cameras, or all around it."""

    out: Path
    """PNG, or GIF with --turntable or --clip; must not exist yet."""
    frame: int | None = None
    """Index of the frame; default 0."""
    view: int = 0
    """Index of the camera."""
    beside: float = 0.0
    """Degrees by which the camera is turned around the middle of the workspace; positive is counterclockwise, seen from
    above."""
    turntable: int | None = None
    """Number of pictures of a full turn around the scene, as a GIF."""
    clip: Switch = False
    """All frames, as a GIF."""
    resolution: str | None = None
    """Width x height, such as 128x128; default the camera's."""


@dataclass(frozen=True, kw_only=True)
class Mesh(_OfScene, _OfObject):
    """Write an object's surface as a coloured triangle mesh, world frame, metres."""

    out: Path
    """PLY or GLB; must not exist yet."""
    frame: int = 0
    """Index of the frame."""
    cells: int = 48
    """Points along each edge of the object's box at which its field is evaluated."""


@dataclass(frozen=True, kw_only=True)
class Remove(_OfScene, _OfObject, _Shown):
    """Remove an object."""


@dataclass(frozen=True, kw_only=True)
class Move(_OfScene, _OfObject, _Placed, _Shown):
    """Move an object by a displacement, or to a position."""


@dataclass(frozen=True, kw_only=True)
class Rotate(_OfScene, _OfObject, _Shown):
    """Turn an object about the centre of its box."""

    degrees: float
    """Angle; counterclockwise, seen against the axis."""
    axis: Literal["x", "y", "z"] = "z"
    """Axis of the world."""


@dataclass(frozen=True, kw_only=True)
class Swap(_OfScene, _Shown):
    """Exchange the positions of two objects."""

    objects: tuple[int, int]
    """Names of the two objects."""


@dataclass(frozen=True, kw_only=True)
class Add(_OfScene, _OfObject, _Placed, _Shown):
    """Add a copy of an object, from the same scene or from another one of the same model."""

    source: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    """Folder of the scene that it comes from; default the same scene."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one subcommand and give its exit code."""
    return run_command(
        PROGRAM,
        COMMANDS,
        description=__doc__,
        arguments=arguments,
        interrupted="Interrupted; nothing was changed.",
        out_of_memory="Out of memory; give a smaller --resolution, or fewer --cells for a mesh.",
    )


_ACTIONS = "obpose.commands.edit:"
COMMANDS = {
    "infer": Command(Infer, _ACTIONS + "infer"),
    "sample": Command(Sample, _ACTIONS + "sample"),
    "fit-prior": Command(FitPrior, _ACTIONS + "fit_prior"),
    "render": Command(Render, _ACTIONS + "render"),
    "mesh": Command(Mesh, _ACTIONS + "mesh"),
    "remove": Command(Remove, _ACTIONS + "remove"),
    "move": Command(Move, _ACTIONS + "move"),
    "rotate": Command(Rotate, _ACTIONS + "rotate"),
    "swap": Command(Swap, _ACTIONS + "swap"),
    "add": Command(Add, _ACTIONS + "add"),
}

if __name__ == "__main__":
    sys.exit(main())
