"""Choices of the user about an import; the flags of `obpose-datagen import` are derived from them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

Format = Literal["rgbd", "obsurf", "obpose", "bop", "octscenes"]
Grouping = Literal["clip", "views", "stills"]
"""Meaning of the images of a recording: frames of a clip, views of a still scene, or a scene each."""
DepthType = Literal["planar", "euclidean"]
"""Depth along the optical axis, or along the ray."""
World = Literal["auto", "given", "table"]
"""World frame: that of the given poses, or one that stands on the table; `auto` is `given` if there are poses."""


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """Choices about how files are read."""

    depth_scale: float | None = None
    """Metres per unit of depth, such as 0.001; for obsurf, of the scene's unit. Default the source's."""
    depth_type: DepthType | None = None
    """Depth along the optical axis or along the ray; default the source's."""
    most_objects: int | None = None
    """For obsurf: leave out scenes with more objects; default 6."""
    camera: Path | None = None
    """File with the camera, where it is not beside the images."""
    ignore_masks: bool = False
    """Leave masks out."""
    predicted_masks: bool = False
    """For rgbd: import only recordings whose masks are predictions of another model, as camera.json says. By default,
    such masks are left out, and so are masks that do not tell objects apart."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """Import a dataset of another project; see docs/import.md for the formats."""

    source: Path
    """Folder of the dataset."""
    format: Format
    """`rgbd`: image files with camera.json; `obsurf`: CLEVR-3D and MultiShapeNet; `obpose`: the paper authors' .npy
    files; `bop`: BOP, scenewise; `octscenes`: OCTScenes."""
    out: Path
    """Folder of the new dataset."""
    group: Grouping | None = None
    """Meaning of a recording's images: frames of a `clip` of a static camera, `views` of a still scene, or `stills`, a
    scene each; default the format's."""
    frames: int | None = None
    """Images of a clip; longer recordings are cut into several clips."""
    views: int | None = None
    """Images of a still scene with --group views, spread evenly over the recording."""
    size: tuple[int, int] | None = None
    """Width and height in pixels; None for that of the images."""
    split: Literal["train", "val", "test"] | None = None
    """Split of all scenes; default the published ones, or 80/10/10."""
    scenes: int | None = None
    """Most scenes of each split."""
    objects: int | None = None
    """Most objects of a scene, from which models take their number of slots; default that of the masks, or 6."""
    world: World = "auto"
    """World frame of the given poses, or one on the table found in the first image; `auto`: given poses if there are
    any."""
    fps: float | None = None
    """Frames per second of clips; default the source's, or 10."""
    reading: ReadOptions = field(default_factory=ReadOptions)
    """Options of reading files."""
