"""Pictures of a dataset to look at: a contact sheet, and an animation of clips."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Integer, UInt8
from PIL import Image, ImageDraw, ImageFont

from datagen.errors import UsageError
from datagen.schema import SceneRecord
from datagen.storage.reader import Dataset, Split
from datagen.storage.spec import groups_of

LEAST_TILE = 160
"""Least width of an image in the preview, pixels; smaller ones are enlarged by a whole factor."""

WIDEST = 2000
"""Width at which the sheet starts a new line of scenes, pixels."""

SHOWN = 4
"""Number of scenes drawn by default."""

LONGEST = 655_350
"""Longest duration of one GIF image, milliseconds; Pillow merges equal frames into one image."""

SHEET_ENDINGS = (".png", ".jpg", ".jpeg")
ANIMATION_ENDINGS = (".gif", ".mp4")

GAP = 6
HEADING = 18
PAPER, INK = (255, 255, 255), (40, 40, 40)

DEPTH_COLORS = np.array(
    [(250, 240, 190), (250, 180, 110), (230, 100, 90), (160, 50, 110), (80, 20, 110), (20, 10, 50)], np.float64
)
"""Colours of depth from near to far; pixels without depth are black."""

Rgb = UInt8[np.ndarray, "_ _ 3"]
Labels = Integer[np.ndarray, "_ _"]


def run(
    folder: str | Path,
    *,
    split: str | None = None,
    scenes: Sequence[int] | None = None,
    out: str | Path | None = None,
    video: str | Path | None = None,
) -> list[Path]:
    """Draw scenes of a dataset and return the paths of the pictures.

    Args:
        folder: The dataset.
        split: One of its splits; the first that has scenes if None.
        scenes: Indices within the split; the first four, or as many as there are, if None.
        out: Where the contact sheet goes (PNG or JPEG); `preview.png` in the dataset's folder by default.
        video: Where an animation goes (`.gif`, or `.mp4` with a codec); by default none for datasets of stills and
            `preview.gif` in the dataset's folder for clips.

    Raises:
        UsageError: there are no images, no such scenes, no codec, or a file's name has another ending.
    """
    dataset = Dataset(folder)
    if dataset.spec["resolution"] is None:
        raise UsageError(f"{folder} holds no images; render it first with `obpose-datagen render --from {folder}`.")
    sheet = _named(out or dataset.folder / "preview.png", SHEET_ENDINGS)
    animation = _named(video or dataset.folder / "preview.gif", ANIMATION_ENDINGS)
    chosen = _chosen(_split(dataset, split), scenes)
    Image.fromarray(contact_sheet(chosen)).save(_ready(sheet))
    if video is None and dataset.spec["recipe"]["frames"] == 1:
        return [sheet]
    save_animation(_ready(animation), list(animation_frames(chosen)), dataset.spec["recipe"]["fps"])
    return [sheet, animation]


def contact_sheet(records: dict[str, SceneRecord]) -> Rgb:
    """One picture of all scenes: columns are views of the first, middle and last frame; rows are as in `_rows`."""
    return _flow([_with_heading(_scene_block(record), name) for name, record in records.items()])


def animation_frames(records: dict[str, SceneRecord]) -> Iterator[Rgb]:
    """One picture per frame: colour, depth and ids of the first view of every scene."""
    for frame in range(min(record["rgb"].shape[0] for record in records.values())):
        rows = {name: [row(record, frame, 0) for row in _rows(record).values()] for name, record in records.items()}
        yield _flow([_with_heading(_beside([_enlarged(tile) for tile in tiles]), name) for name, tiles in rows.items()])


def save_animation(path: Path, frames: list[Rgb], fps: float) -> None:
    """Write an MP4 if the name ends in .mp4, otherwise a GIF that loops forever.

    Raises:
        UsageError: there is no codec for MP4.
    """
    if path.suffix.lower() == ".mp4":
        _save_mp4(path, frames, fps)
        return
    # Pillow's own choice of palette spends its colours on the depth and gives objects those of their neighbours.
    images = [Image.fromarray(frame).quantize(256, Image.Quantize.FASTOCTREE) for frame in frames]
    milliseconds = min(round(1000 / fps), LONGEST // len(images))
    images[0].save(path, save_all=True, append_images=images[1:], duration=milliseconds, loop=0)


def colored_depth(depth: Labels, near: float, far: float) -> Rgb:
    """Depth between `near` and `far` (stored units) as colours, 0 as black."""
    place = np.clip((depth - near) / max(far - near, 1), 0, 1) * (len(DEPTH_COLORS) - 1)
    anchors = np.arange(len(DEPTH_COLORS))
    channels = [np.interp(place, anchors, DEPTH_COLORS[:, channel]) for channel in range(3)]
    return np.where(depth[..., None] > 0, np.stack(channels, axis=-1), 0).astype(np.uint8)


def colored_labels(labels: Labels) -> Rgb:
    """Ids as distinct colours; 0 is dark grey."""
    return label_colors(int(np.max(labels)) + 1)[labels]


def label_colors(count: int) -> UInt8[np.ndarray, "label 3"]:
    """Colours of ids 0 to count - 1; hues a golden angle apart keep nearby ids distinct."""
    hues = (np.arange(count)[:, None] * 0.618034 + np.array([0, 1 / 3, 2 / 3])) % 1
    colors = 60 + 195 * np.clip(np.abs(6 * hues - 3) - 1, 0, 1)
    colors[:1] = 45
    return colors.astype(np.uint8)


def _named(path: str | Path, endings: tuple[str, ...]) -> Path:
    if Path(path).suffix.lower() not in endings:
        raise UsageError(f"Cannot draw into {path}; end the name in {' or '.join(endings)}.")
    return Path(path)


def _split(dataset: Dataset, name: str | None) -> Split:
    filled = [split for split, size in dataset.splits.items() if size]
    if name in filled or (name is None and filled):
        return dataset.split(name or filled[0])
    there = f"choose from {', '.join(filled)}" if filled else "there is nothing to draw"
    raise UsageError(f"{dataset.folder} holds no scene{f' of split {name}' if name else ''}; {there}.")


def _chosen(scenes: Split, wanted: Sequence[int] | None) -> dict[str, SceneRecord]:
    indices = range(min(SHOWN, len(scenes))) if wanted is None else wanted
    if not indices:
        raise UsageError("No scene is named; give some, such as --scenes 0 1.")
    if wrong := [index for index in indices if not 0 <= index < len(scenes)]:
        raise UsageError(f"Split {scenes.name} has scenes 0 to {len(scenes) - 1}, but {wrong[0]} was asked for.")
    fields = ["rgb", "depth", "segmentation", *(["sensor_depth"] if "sensor" in groups_of(scenes.spec) else [])]
    return {f"{scenes.name} scene {index}": scenes.read(index, fields) for index in indices}


def _ready(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _rows(record: SceneRecord) -> dict[str, Callable[[SceneRecord, int, int], Rgb]]:
    """Rows of the preview by name, top to bottom; each function draws its row from (record, frame, view)."""
    seen = record["depth"][record["depth"] > 0]
    near, far = (float(np.min(seen)), float(np.max(seen))) if len(seen) else (0.0, 1.0)
    rows: dict[str, Callable[[SceneRecord, int, int], Rgb]] = {
        "rgb": lambda record, frame, view: record["rgb"][frame, view],
        "depth": lambda record, frame, view: colored_depth(record["depth"][frame, view], near, far),
        "ids": lambda record, frame, view: colored_labels(record["segmentation"][frame, view]),
    }
    if "sensor_depth" in record:
        rows["sensor"] = lambda record, frame, view: colored_depth(record["sensor_depth"][frame, view], near, far)
    return rows


def _scene_block(record: SceneRecord) -> Rgb:
    frames, views = record["rgb"].shape[:2]
    shown = sorted({0, frames // 2, frames - 1})
    images = [(frame, view) for frame in shown for view in range(views)]
    rows = _rows(record)
    columns = [_with_heading(_stacked([_label(name, _enlarged(record["rgb"][0, 0]).shape[0]) for name in rows]), "")]
    for frame, view in images:
        tiles = [_enlarged(row(record, frame, view)) for row in rows.values()]
        name = f"view {view}" if frames == 1 else f"frame {frame}" + (f", view {view}" if views > 1 else "")
        columns.append(_with_heading(_stacked(tiles), name))
    return _beside(columns)


def _enlarged(tile: Rgb) -> Rgb:
    factor = max(1, -(-LEAST_TILE // tile.shape[1]))
    return np.repeat(np.repeat(tile, factor, axis=0), factor, axis=1)


def _with_heading(picture: Rgb, text: str) -> Rgb:
    return np.concatenate([_text(text, picture.shape[1]), picture])


def _label(text: str, length: int) -> Rgb:
    """Text that reads upwards, centred in a column `length` pixels high."""
    return np.rot90(_text(text, length, centered=True))


def _text(text: str, width: int, *, centered: bool = False) -> Rgb:
    paper = Image.new("RGB", (width, HEADING), PAPER)
    place, anchor = ((width / 2, 1), "ma") if centered else ((1, 1), "la")
    ImageDraw.Draw(paper).text(place, text, INK, ImageFont.load_default(size=13), anchor=anchor)
    return np.asarray(paper)


def _beside(pictures: Sequence[Rgb]) -> Rgb:
    height, width = max(p.shape[0] for p in pictures), sum(p.shape[1] + GAP for p in pictures) - GAP
    paper = np.full((height, width, 3), PAPER, np.uint8)
    left = 0
    for picture in pictures:
        paper[: picture.shape[0], left : left + picture.shape[1]] = picture
        left += picture.shape[1] + GAP
    return paper


def _stacked(pictures: Sequence[Rgb]) -> Rgb:
    return _beside([picture.swapaxes(0, 1) for picture in pictures]).swapaxes(0, 1)


def _flow(blocks: list[Rgb]) -> Rgb:
    """Arrange blocks of one size in lines, with a margin around each."""
    per_line = max(1, WIDEST // (blocks[0].shape[1] + 2 * GAP))
    lines = [blocks[start : start + per_line] for start in range(0, len(blocks), per_line)]
    wide = [_beside([np.pad(b, ((0, GAP), (GAP, GAP), (0, 0)), constant_values=255) for b in line]) for line in lines]
    return _stacked(wide)


def _save_mp4(path: Path, frames: list[Rgb], fps: float) -> None:
    import imageio.v3

    # Video codecs work in blocks of 16 pixels.
    padding = [(0, -side % 16) for side in frames[0].shape[:2]]
    padded = np.stack([np.pad(frame, (*padding, (0, 0)), constant_values=255) for frame in frames])
    try:
        imageio.v3.imwrite(path, padded, plugin="FFMPEG", fps=fps)
    except ImportError as error:
        raise UsageError(
            f"Cannot write {path.name}: there is no MP4 codec. Install one with `pip install imageio[ffmpeg]`, or end "
            "the name in .gif."
        ) from error
