"""Flags of `obpose-edit`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from obpose.rgbd.frames import Frames
from obpose.scenes.refine import STEPS

Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]
SceneFolder = Annotated[Path, tyro.conf.Positional]


@dataclass(frozen=True)
class _Shown:
    """What is drawn of the result."""

    out: Path
    """Folder for the new scene and its picture; it must not hold anything yet."""
    resolution: str | None = None
    """Of the picture, such as 128x128 (width x height); that of the camera if left out."""
    checkpoint: str | None = None
    """Folder of the model, or the name of weights that ship with this package; the scene knows it by itself unless it
    was moved."""


@dataclass(frozen=True, kw_only=True)
class Infer(Frames):
    """Infer a scene from a clip of a dataset, or from RGB-D frames of your own."""

    checkpoint: str
    """Folder of a trained model, or the name of weights that ship with this package."""
    out: Path
    """Folder for the scene and its picture; it must not hold anything yet."""
    data: Path | None = None
    """Folder of a dataset with images, in the place of frames."""
    split: Literal["train", "val", "test"] = "test"
    scene: int = 0
    """Which of the split's scenes."""
    resolution: str | None = None
    """Of the picture, such as 128x128; that of the data if left out."""
    refine: int = STEPS
    """Steps in which what was inferred is then fitted to the frames, which takes seconds; 0: codes as the model reads
    them, without any detail."""


@dataclass(frozen=True)
class Sample:
    """Sample a scene that was never seen."""

    checkpoint: str
    """Folder of a trained model, or the name of weights that ship with this package."""
    out: Path
    """Folder for the scene and its picture; it must not hold anything yet."""
    camera: Path
    """Folder of a scene whose cameras are used."""
    objects: int = 3
    seed: int = 0
    prior: Literal["flow", "fitted", "learned", "found"] | None = None
    """`flow`: whole objects, with details, of a flow that `obpose-edit learn` made; `fitted`: mixtures of Gaussians of
    what the model infers from training clips, which `obpose-edit fit` made and shipped weights have; `learned`: the
    model's own priors; `found`: whole objects, with details, that the model finds in training clips of --data, of which
    only company and place are new. If left out, the flow where the weights have one, else the mixtures."""
    data: Path | None = None
    """Folder of the dataset whose objects are taken, for --prior found."""
    clips: int = 8
    """How many of its training clips are looked at for --prior found, chosen by the seed; each takes some seconds."""
    resolution: str | None = None
    """Of the picture, such as 128x128; that of the camera if left out."""


@dataclass(frozen=True)
class Fit:
    """Fit the mixtures that scenes are sampled from, beside a model's weights."""

    checkpoint: str
    """Folder of a trained model."""
    data: Path
    """Folder of the dataset that it was trained on."""
    clips: int = 500
    """How many of the training split."""


@dataclass(frozen=True)
class Learn:
    """Learn a flow that whole objects are sampled from, beside a model's weights.

    What was done when it was stopped is kept, and the same command goes on.
    """

    checkpoint: str
    """Folder of a trained model, to which `obpose-edit fit` has fitted mixtures."""
    data: Path
    """Folder of the dataset that it was trained on."""
    clips: int = 400
    """How many of the training split objects are looked for in, for some seconds each."""
    steps: int = 3000
    """Of learning, about a tenth of a second each."""
    seed: int = 0
    workers: int | None = None
    """Processes that look for objects; as many as there are processors if left out."""


@dataclass(frozen=True)
class Render:
    """Render a scene from one of its cameras, or all around it."""

    scene: SceneFolder
    """Folder of a scene."""
    out: Path
    """PNG, or GIF of a turn or of all frames; must not exist yet."""
    frame: int | None = None
    """The first one if left out."""
    view: int = 0
    """Which of the scene's cameras."""
    turntable: int | None = None
    """Pictures of a whole turn around the scene, as a GIF."""
    clip: Switch = False
    """All frames, as a GIF."""
    resolution: str | None = None
    """Such as 128x128; that of the camera if left out."""
    checkpoint: str | None = None
    """Where the scene's model is, if it was moved."""


@dataclass(frozen=True)
class Mesh:
    """Write an object's surface as a coloured triangle mesh, world frame, metres."""

    scene: SceneFolder
    """Folder of a scene."""
    object: int
    """Its number, as printed and coloured."""
    out: Path
    """PLY or GLB; must not exist yet."""
    frame: int = 0
    cells: int = 48
    """Points along each edge of its box at which its field is looked at."""
    checkpoint: str | None = None
    """Where the scene's model is, if it was moved."""


@dataclass(frozen=True)
class _Edit(_Shown):
    scene: SceneFolder = field(kw_only=True)
    """Folder of a scene."""


@dataclass(frozen=True)
class Remove(_Edit):
    """Remove an object."""

    object: int = field(kw_only=True)
    """Its number, as printed and coloured."""


@dataclass(frozen=True)
class Move(_Edit):
    """Move an object by a distance, or to a place."""

    object: int = field(kw_only=True)
    """Its number, as printed and coloured."""
    by: str | None = None
    """x,y,z in metres, world frame, such as 0.1,0,0."""
    to: str | None = None
    """x,y,z in metres: of the middle of its box in the first frame."""


@dataclass(frozen=True)
class Rotate(_Edit):
    """Turn an object about its middle."""

    object: int = field(kw_only=True)
    """Its number, as printed and coloured."""
    degrees: float = field(kw_only=True)
    """Counterclockwise, seen from above or against the axis."""
    axis: Literal["x", "y", "z"] = "z"
    """Of the world."""


@dataclass(frozen=True)
class Swap(_Edit):
    """Let two objects change places."""

    objects: tuple[int, int] = field(kw_only=True)


@dataclass(frozen=True)
class Add(_Edit):
    """Add a copy of an object, of the same scene or of another of the same model."""

    object: int = field(kw_only=True)
    """Its number in the scene that it comes from."""
    source: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    """Folder of the scene that it comes from; the same if left out."""
    by: str | None = None
    """x,y,z in metres that it is displaced by."""
    to: str | None = None
    """x,y,z in metres: where the middle of its box is in the first frame."""
