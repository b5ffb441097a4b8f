"""Report on a folder of meshes: a table, the problems, and a sheet of thumbnails."""

import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw
from rich.console import Console
from rich.markup import escape

from datagen.console.text import counted
from datagen.errors import EXIT_OK, EXIT_VERIFICATION, UsageError
from datagen.meshes.build import make_shape, mass_of
from datagen.meshes.survey import Examined, Reading, examine, find_files, name_files
from datagen.render import make_renderer
from datagen.sampling.poses import upright
from datagen.scene import Body, Camera, Light, Material, Scene, ShapeSpec, Table
from datagen.storage.atomic import write_atomically

_WIDTHS = {
    "unit (why)": 22,
    "size (cm)": 18,
    "faces": 7,
    "closed": 6,
    "parts / bodies": 14,
    "hulls, beyond": 16,
    "cm³": 6,
    "colours": 0,
}
"""Columns of the table after the mesh's name, with their widths."""

TILE = 192
"""Width and height of a thumbnail, pixels."""

COLUMNS = 5
_LINE = 14
_PAPER, _INK, _ALARM = (255, 255, 255), (40, 40, 40), (180, 30, 30)
_ENDINGS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}
_PLAIN = Material("plastic", (0.55, 0.6, 0.7), roughness=0.5)
_LIGHTS = (
    Light((0.48, 0.36, 0.8), (0.9, 0.9, 0.9), 0.04),
    Light((0.2, -0.7, 0.69), (0.2, 0.2, 0.2), 0.0, casts_shadow=False),
)


def run(folder: Path, reading: Reading, out: Path) -> int:
    """Print a row for each mesh as it is examined, draw thumbnails of all, and return the exit code.

    Raises:
        UsageError: there is no such folder, no mesh in it, or the sheet's name has another ending.
    """
    if out.suffix.lower() not in _ENDINGS:
        raise UsageError(f"--out {out}: expected a name that ends in {', '.join(_ENDINGS)}.")
    files = find_files(folder)
    names = name_files(files)
    widths = {"mesh": max(map(len, ("mesh", *names))), **_WIDTHS}
    console = Console(markup=False, highlight=False, emoji=False, soft_wrap=True)
    console.print(_line(widths, widths))
    tiles, unusable = [], 0
    # On a terminal, one console must draw both, or rows would be appended to the status line.
    with (console if console.is_terminal else Console(stderr=True)).status("") as status:
        for number, (file, name) in enumerate(zip(files, names, strict=True), 1):
            status.update(
                escape(
                    f"Mesh {number} of {len(files)}, {name}: at most {reading.seconds:.0f} CPU-seconds for its hulls"
                )
            )
            one = examine(folder, file, name, reading)
            console.print(_line(widths, (name, *_cells(one))))
            found = problems(one)
            for line in found:
                console.print(f"    {line}")
            unusable += any(line.startswith("ERROR") for line in found)
            tiles.append(thumbnail(one))
    buffer = io.BytesIO()
    Image.fromarray(sheet(tiles)).save(buffer, _ENDINGS[out.suffix.lower()])
    write_atomically(out, buffer.getvalue())
    console.print(f"{counted(len(files), 'mesh', 'meshes')}, {unusable} need attention; thumbnails in {out}")
    return EXIT_VERIFICATION if unusable else EXIT_OK


def _line(widths: Mapping[str, int], cells: Iterable[str]) -> str:
    return "  ".join(cell.ljust(width) for cell, width in zip(cells, widths.values(), strict=True)).rstrip()


def _cells(one: Examined) -> Sequence[str]:
    if not (one.raw and one.placed and one.hulls and one.guess):
        return ["-"] * len(_WIDTHS)
    surface = one.placed.surface
    mass = mass_of(surface, one.hulls.parts)
    return (
        f"{one.guess.unit} ({one.guess.reason})" if one.guess.certain else f"{one.guess.unit}? (a guess)",
        " x ".join(f"{100 * side:.1f}" for side in one.size),
        f"{len(surface.faces):,}",
        "yes" if surface.closed else "no",
        f"{one.raw.parts} / {surface.bodies}",
        f"{len(one.hulls.parts)} {one.hulls.method}, {1e3 * one.hulls.beyond:.1f} mm",
        f"{1e6 * mass.volume:.4g}",
        _colors(one),
    )


def _colors(one: Examined) -> str:
    if one.raw is None or not one.raw.has_colors:
        return "none"
    sizes = [f"{image.shape[1]}x{image.shape[0]}" for image in one.raw.images]
    return "texture " + ", ".join(sizes) if sizes else "vertex or material"


def problems(one: Examined) -> list[str]:
    """One line for each thing that the user should know."""
    lines = [f"ERROR {one.failure}"] if one.failure else []
    if one.guess and not one.guess.certain:
        lines.append(f"ERROR {one.file}: {one.guess.reason}; give --unit m, cm, mm or in, and perhaps --scale.")
    return lines + [f"note  {one.file}: {warning}" for warning in one.warnings]


def thumbnail(one: Examined) -> UInt8[np.ndarray, "height width 3"]:
    """A mesh on a table, or its error, with its name and size below."""
    tile = Image.new("RGB", (TILE, TILE + 2 * _LINE + 4), _PAPER)
    draw = ImageDraw.Draw(tile)
    draw.text((4, TILE + 2), one.name[:30], fill=_INK)
    if one.placed and one.hulls:
        tile.paste(Image.fromarray(_picture(one)), (0, 0))
        sides = " x ".join(f"{100 * side:.1f}" for side in one.size)
        draw.text((4, TILE + _LINE + 2), f"{sides} cm", fill=_INK)
    else:
        draw.rectangle((0, 0, TILE - 1, TILE - 1), outline=_ALARM)
        draw.text((8, TILE // 2 - 8), "cannot be used", fill=_ALARM)
    return np.asarray(tile)


def _picture(one: Examined) -> UInt8[np.ndarray, "height width 3"]:
    assert one.placed
    assert one.hulls
    shape = make_shape(one.placed, mass_of(one.placed.surface, one.hulls.parts), one.hulls.parts)
    stance = upright(shape)
    radius = shape.radius
    distance = max(4 * radius, 0.3)
    height = -float(np.min((shape.vertices @ stance.rotation.T)[:, 2]))
    pose = np.eye(4)
    pose[:3, :3], pose[2, 3] = stance.rotation, height
    camera = Camera(
        (0.75 * distance, 0.35 * distance, 0.56 * distance + height),
        (0.0, 0.0, height),
        2.4 * np.arctan(radius / distance),
    )
    material = Material("image", shape.skin.mean, pattern="image", roughness=0.5) if shape.skin else _PLAIN
    body = Body(
        one.name, ShapeSpec("mesh"), material, 500.0, 0.5, 0.5, "rest", (0.0, 0.0, height), (1.0, 0.0, 0.0, 0.0)
    )
    scene = Scene(
        (body,), Table(20 * distance, Material("paint", (0.75, 0.75, 0.77), roughness=0.8)), (camera,), _LIGHTS,
        (0.3, 0.3, 0.3), (0.6, 0.6, 0.6), 1, 12.0,
    )  # fmt: skip
    renderer = make_renderer("raster")
    renderer.load(scene, (shape,))
    return renderer.render(pose[None], camera, TILE, TILE).rgb


def sheet(tiles: Sequence[UInt8[np.ndarray, "height width 3"]]) -> UInt8[np.ndarray, "_ _ 3"]:
    """Thumbnails in rows."""
    columns = min(COLUMNS, len(tiles))
    blank = np.full_like(tiles[0], 255)
    padded = [*tiles, *[blank] * (-len(tiles) % columns)]
    rows = [np.concatenate(padded[i : i + columns], axis=1) for i in range(0, len(padded), columns)]
    return np.concatenate(rows)
