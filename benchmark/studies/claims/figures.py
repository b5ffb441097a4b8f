"""Figures 1 and 2 of the paper, redone."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image, ImageDraw
from torch import Tensor

from benchmark.studies.claims.drawing import Cubes, Eye, Line, draw, look_at
from benchmark.studies.claims.frames import FRAMINGS, Cells, Framing, cells_of, occupied
from benchmark.studies.claims.scenes import Account, Found
from datagen.errors import UsageError
from obpose.model.nerf.voxels import Voxels
from obpose.pictures import PALETTE
from obpose.types import Boxes

TILE = 200
"""Pixels of a picture's edge."""
MARGIN, LINE = 92, 16
"""Pixels for names at the left and for titles above."""
FRAMES = 4
"""Shown of a clip."""
GREY, BLACK = (205, 205, 205), (60, 60, 60)
SIDE = (0.9, -0.35, 0.55)
"""Where pictures that no camera took are seen from."""


def voxels_and_poses(account: Account, voxels: Voxels) -> Image.Image:
    """Figure 1: image, occupied voxels with the tightest boxes along R as the camera sees them, and from the side.

    Raises:
        UsageError: the model finds no object.
    """
    observation, inference = account.scene.observation, account.segmentation.inference
    shown = [label - 1 for label in account.segmentation.labels.unique().tolist() if label]
    if not shown:
        raise UsageError("The model finds no object in the scene of figure 1; give another with --figure-scenes.")
    frames = _spread(range(observation.depth.shape[1]))
    pose, k = observation.world_from_camera[0, 0].numpy(), observation.k[0, 0].numpy()
    camera = Eye(pose[:3, 3], pose[:3, :3], float(k[0, 0]) / observation.depth.shape[-1])
    middle = inference.boxes.center[0, :, shown].flatten(0, 1).median(dim=0).values.numpy()
    side = look_at(middle, SIDE, distance=1.6, focal=2.2)
    rows: dict[str, list[Image.Image]] = {"image": [], "voxels and\npose": [], "from the\nside": []}
    for frame in frames:
        groups, wires = [], []
        for slot in shown:
            colour = PALETTE[1 + slot % (len(PALETTE) - 1)]
            group = _voxel_cubes(voxels, inference.boxes, frame, slot, colour / 255)
            if len(group.centers):
                groups.append(group)
                wires += _tight_box(group, tuple(colour.tolist()))
        image = (255 * observation.rgb[0, frame, 0].numpy()).round().astype(np.uint8)
        tiles = [Image.fromarray(image).resize((TILE, TILE), Image.Resampling.NEAREST)]
        tiles += [draw(groups, eye, size=TILE, below=_table(middle), over=wires) for eye in (camera, side)]
        for row, tile in zip(rows.values(), tiles, strict=True):
            row.append(tile)
    return _sheet([f"frame {frame}" for frame in frames], rows)


def appearances(accounts: Mapping[Framing, tuple[Account, Found]], *, resolution: int) -> Image.Image:
    """Figure 2: an object's field in its own frame over time, and how often each voxel is occupied there."""
    rows, titles = {}, []
    for framing in FRAMINGS:
        account, found = accounts[framing]
        edge = account.model.config.model.pose.box_size
        cells = cells_of(account, found, framing, edge=edge, cell=edge / resolution)
        dense, colours = occupied(account, found, cells.points)
        places = _spread(range(len(found.frames)))
        mean = dense.float().mean(dim=0)
        tiles = [_appearance(cells, dense[place].float(), colours[place]) for place in places]
        tiles.append(_appearance(cells, mean, torch.tensor([0.1, 0.2, 0.5]).expand(len(mean), 3)))
        rows[framing.replace("full", "location\nand rotation")] = tiles
        titles = [*(f"frame {found.frames[place]}" for place in places), "share of frames"]
    return _sheet(titles, rows)


def _appearance(cells: Cells, share: Float[Tensor, " cell"], colours: Float[Tensor, "cell 3"]) -> Image.Image:
    """One picture of the lattice, which stands still."""
    still = Cells(torch.zeros(1, 3), torch.eye(3)[None], cells.size, cells.resolution)
    there = share > 0
    cubes = Cubes(
        still.points[0, there].numpy(),
        np.eye(3),
        cells.size / cells.resolution,
        colours[there].numpy(),
        share[there].numpy(),
    )
    eye = look_at(np.zeros(3), SIDE, distance=4 * cells.size, focal=2.3)
    return draw([cubes], eye, size=TILE, below=_wires(np.zeros(3), np.eye(3), np.full(3, cells.size / 2), GREY))


def _voxel_cubes(voxels: Voxels, boxes: Boxes, frame: int, slot: int, colour: np.ndarray) -> Cubes:
    points = voxels.points[0, frame, slot][voxels.occupied[0, frame, slot]].numpy()
    resolution = round(voxels.points.shape[-2] ** (1 / 3))
    shape = (len(points), 3)
    rotation = boxes.rotation[0, frame, slot].numpy()
    return Cubes(points, rotation, boxes.size / resolution, np.broadcast_to(colour, shape), np.ones(len(points)))


def _tight_box(cubes: Cubes, colour: tuple[int, int, int]) -> list[Line]:
    """Around the cubes, along their axes."""
    local = cubes.centers @ cubes.rotation
    low, high = local.min(axis=0) - cubes.edge / 2, local.max(axis=0) + cubes.edge / 2
    return _wires(cubes.rotation @ ((low + high) / 2), cubes.rotation, (high - low) / 2, colour)


def _wires(center: np.ndarray, rotation: np.ndarray, half: np.ndarray, colour: tuple[int, int, int]) -> list[Line]:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half @ rotation.T + center
    # Corners of an edge differ in one coordinate, which is one bit of their numbers.
    edges = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    return [Line(corners[list(edge)], colour) for edge in edges]


def _table(middle: np.ndarray) -> list[Line]:
    """Lines on the table z = 0, ten centimetres apart."""
    steps, reach = np.arange(-4, 5) / 10, 0.4
    x, y = np.round(middle[:2], 1)
    ends = [[(x + step, y - reach, 0), (x + step, y + reach, 0)] for step in steps]
    ends += [[(x - reach, y + step, 0), (x + reach, y + step, 0)] for step in steps]
    return [Line(np.array(pair), GREY, 1) for pair in ends]


def _spread(places: Sequence[int]) -> list[int]:
    """A few, evenly."""
    return [places[i] for i in np.linspace(0, len(places) - 1, min(FRAMES, len(places))).round().astype(int)]


def _sheet(titles: Sequence[str], rows: Mapping[str, Sequence[Image.Image]]) -> Image.Image:
    sheet = Image.new("RGB", (MARGIN + len(titles) * TILE, LINE + len(rows) * TILE), (255, 255, 255))
    pen = ImageDraw.Draw(sheet)
    for column, title in enumerate(titles):
        pen.text((MARGIN + column * TILE + 4, 2), title, fill=BLACK)
    for row, (name, tiles) in enumerate(rows.items()):
        pen.multiline_text((4, LINE + row * TILE + TILE // 2 - 8), name, fill=BLACK)
        for column, tile in enumerate(tiles):
            sheet.paste(tile, (MARGIN + column * TILE, LINE + row * TILE))
    return sheet
