"""The subcommand `obpose-datagen import`: flags, checks and summary."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from datagen.commands.options import parse_resolution
from datagen.errors import EXIT_OK, UsageError

if TYPE_CHECKING:
    from datagen.formats.importers.write import Report

_MOST = {
    "frames": 10_000,
    "views": 360,
    "scenes": 1_000_000,
    "objects": 250,
    "most_objects": 250,
    "depth_scale": 1000,
    "fps": 1000,
}
"""Largest values of flags, all of which are positive."""
_Flag = tyro.conf.FlagCreatePairsOff[bool]


@dataclass(frozen=True)
class Import:
    """Import a dataset of another project; see docs/import.md for the formats."""

    source: Annotated[Path, tyro.conf.Positional]
    """Folder of the dataset."""
    format: Literal["rgbd", "obsurf", "obpose", "bop", "octscenes"]
    """`rgbd`: image files with camera.json; `obsurf`: CLEVR-3D and MultiShapeNet; `obpose`: the paper authors' .npy
    files; `bop`: BOP, scenewise; `octscenes`: OCTScenes."""
    out: Path
    """Folder of the new dataset."""
    group: Literal["clip", "views", "stills"] | None = None
    """Meaning of a recording's images: frames of a `clip` of a static camera, `views` of a still scene, or `stills`, a
    scene each; default the format's."""
    frames: int | None = None
    """Images of a clip; longer recordings are cut into several clips."""
    views: int | None = None
    """Images of a still scene with --group views, spread evenly over the recording."""
    resolution: str | None = None
    """Width x height in pixels, such as 160x120; images are cropped to its aspect and scaled."""
    split: Literal["train", "val", "test"] | None = None
    """Split of all scenes; default the published ones, or 80/10/10."""
    scenes: int | None = None
    """Most scenes of each split."""
    objects: int | None = None
    """Most objects of a scene, from which models take their number of slots; default that of the masks, or 6."""
    most_objects: int | None = None
    """For obsurf: leave out scenes with more objects; default 6."""
    depth_scale: float | None = None
    """Metres per unit of integer depth, such as 0.001; for obsurf, of the scene's unit. Default the source's."""
    depth_type: Literal["planar", "euclidean"] | None = None
    """Depth along the optical axis or along the ray; default the source's."""
    world: Literal["auto", "given", "table"] = "auto"
    """World frame of the given poses, or one on the table found in the first image; `auto`: given poses if there are
    any."""
    camera: Path | None = None
    """File with the camera, where it is not beside the images."""
    fps: float | None = None
    """Frames per second of clips; default the source's, or 10."""
    ignore_masks: _Flag = False
    """Leave masks out."""


def run(values: Import) -> int:
    """Import the dataset and print a summary."""
    for name, most in _MOST.items():
        value = getattr(values, name)
        if value is not None and not 0 < value <= most:
            raise UsageError(f"--{name.replace('_', '-')} {value}: expected more than 0 and at most {most:,}.")
    if values.views is not None and values.group not in (None, "views"):
        raise UsageError(f"--views is for --group views, not {values.group}; leave one of them out.")
    if values.frames is not None and values.group not in (None, "clip"):
        raise UsageError(f"--frames is for --group clip, not {values.group}; leave one of them out.")

    from datagen.console.progress import scene_progress
    from datagen.formats.importers.interface import ReadOptions
    from datagen.formats.importers.write import Request, import_dataset

    group = values.group or ("views" if values.views else "clip" if values.frames else None)
    request = Request(
        format=values.format,
        source=values.source,
        out=values.out,
        grouping=group,
        frames=values.frames,
        views=values.views,
        size=parse_resolution(values.resolution) if values.resolution else None,
        split=values.split,
        scenes=values.scenes,
        objects=values.objects,
        world=values.world,
        fps=values.fps,
        reading=ReadOptions(
            depth_scale=values.depth_scale,
            depth_type=values.depth_type,
            masks=not values.ignore_masks,
            most_objects=values.most_objects,
            camera=values.camera,
        ),
    )
    print("\n".join(summary(values.out, import_dataset(request, progress=scene_progress))))
    return EXIT_OK


def summary(folder: Path, report: "Report") -> list[str]:
    """Lines about what was imported, with depths and frames that tell whether units and poses are right."""
    spec, measured = report.spec, report.measured
    counts = ", ".join(f"{number} {name}" for name, number in spec["splits"].items())
    width, height = spec["resolution"]
    frames, views = spec["recipe"]["frames"], spec["recipe"]["views"]
    depths = sorted(each.depth for each in measured)
    missing = sum(each.missing for each in measured) / len(measured)
    far = sum(each.too_far for each in measured) / len(measured)
    on_table = sum(each.estimated_world for each in measured)
    fields = ("segmentation", "poses/position", "boxes/box_3d")
    labelled, posed, boxed = (", ".join(s for s, names in spec["fields"].items() if name in names) for name in fields)
    worlds = {0: "as given by the poses", len(measured): "on the largest plane near the camera, most likely the table"}
    return [
        f"{folder.resolve()}: {counts} scenes of {frames} x {views} images (frames x views) of {width}x{height} "
        f"pixels, in {report.seconds:.1f} s.",
        f"Depth: median {depths[len(depths) // 2]:.2f} m ({depths[0]:.2f} to {depths[-1]:.2f} m by scene), "
        f"{100 * missing:.0f} % missing"
        + (f", {100 * far:.1f} % dropped beyond the format's 6.55 m." if far > 0 else "."),
        f"World: {worlds.get(on_table, 'given in some scenes, on the table in others')}.",
        f"Masks: {labelled or 'none; models can be trained on it but not scored'}.",
        *([f"Poses of objects: {posed}; boxes: {boxed or 'none, because there is no models/'}."] if posed else []),
        *report.notes,
    ]
