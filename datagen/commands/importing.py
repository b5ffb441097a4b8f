"""The subcommand `obpose-datagen import`: flags, checks and summary."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from datagen.commands.options import parse_resolution
from datagen.errors import EXIT_OK, UsageError
from datagen.formats.import_request import ReadOptions, Request

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


@dataclass(frozen=True, kw_only=True)
class Import(Request):
    """Import a dataset of another project; see docs/import.md for the formats."""

    source: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    size: tyro.conf.Suppress[tuple[int, int] | None] = None
    resolution: str | None = None
    """Width x height in pixels, such as 160x120; images are cropped to its aspect and scaled."""
    reading: tyro.conf.OmitArgPrefixes[tyro.conf.FlagCreatePairsOff[ReadOptions]] = field(default_factory=ReadOptions)


def run(values: Import) -> int:
    """Import the dataset and print a summary."""
    given = {**vars(values), **vars(values.reading)}
    for name, most in _MOST.items():
        if given[name] is not None and not 0 < given[name] <= most:
            raise UsageError(f"--{name.replace('_', '-')} {given[name]}: expected more than 0 and at most {most:,}.")
    if values.views is not None and values.group not in (None, "views"):
        raise UsageError(f"--views is for --group views, not {values.group}; leave one of them out.")
    if values.frames is not None and values.group not in (None, "clip"):
        raise UsageError(f"--frames is for --group clip, not {values.group}; leave one of them out.")

    from datagen.console.progress import scene_progress
    from datagen.formats.importers.write import import_dataset

    group = values.group or ("views" if values.views else "clip" if values.frames else None)
    size = parse_resolution(values.resolution) if values.resolution else None
    report = import_dataset(replace(values, group=group, size=size), progress=scene_progress)
    print("\n".join(summary(values.out, report)))
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
