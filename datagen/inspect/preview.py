"""Pictures of a dataset to look at: a contact sheet, and an animation of clips."""

import functools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Integer, UInt8
from PIL import Image, ImageDraw, ImageFont

from datagen.console.text import counted
from datagen.errors import UsageError
from datagen.inspect.signal_pictures import (
    colored_coordinates,
    colored_normals,
    flow_picture,
    signal_legend,
    tracks_picture,
)
from datagen.schema import DEPTH_SCALE, FIELDS, SIGNALS, SceneRecord
from datagen.storage.reader import Dataset, Split
from datagen.storage.spec import Spec, is_imported, views_of

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
BAR = 100
"""Length of the legend's bar of depths, pixels."""
PAPER, INK, EDGE = (255, 255, 255), (40, 40, 40), (150, 150, 150)
"""Colours of the page, of text, and of the edges of the legend's colours, some of which are white."""

DEPTH_COLORS = np.array(
    [(250, 240, 190), (250, 180, 110), (230, 100, 90), (160, 50, 110), (80, 20, 110), (20, 10, 50)], np.float64
)
"""Colours of depth from near to far; pixels without depth are black."""

DEPTH_STEPS = 100
"""Number of depth colours in a GIF's palette."""
LABEL_COLORS = 24
"""Largest number of ids in the legend and in a GIF's palette."""

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

    By default, these are the first four scenes of the first split that has any. The contact sheet (PNG or JPEG) goes to
    `out`, and an animation (GIF, or MP4 with a codec) to `video`. Without either, they are `preview.png` and, of clips,
    `preview.gif` in the dataset's folder.

    Raises:
        UsageError: there are no images, no such scenes, no codec, or a file's name has another ending.
    """
    dataset = Dataset(folder)
    if dataset.spec["resolution"] is None:
        raise UsageError(f"{folder} holds no images; render it first with `obpose-datagen render --from {folder}`.")
    if out is None and video is None:
        out = dataset.folder / "preview.png"
        video = dataset.folder / "preview.gif" if dataset.spec["recipe"]["frames"] > 1 else None
    sheet = out and _named(out, SHEET_ENDINGS)
    animation = video and _named(video, ANIMATION_ENDINGS)
    chosen = _chosen(_split(dataset, split), scenes)
    title = _title(dataset.spec)
    if sheet:
        Image.fromarray(contact_sheet(chosen, title)).save(_ready(sheet))
    if animation:
        frames = list(animation_frames(chosen, title))
        save_animation(_ready(animation), frames, dataset.spec["recipe"]["fps"], gif_palette(chosen))
    return [path for path in (sheet, animation) if path]


def contact_sheet(records: dict[str, SceneRecord], title: str = "") -> Rgb:
    """One picture of all scenes, with a title and a legend.

    Columns are views of the first, middle and last frame; rows are colour, depth, ids and, if stored, sensor depth
    and signals.
    """
    span = _depth_span(records)
    return _page(title, [_with_heading(_scene_block(record, span), name) for name, record in records.items()], records)


def animation_frames(records: dict[str, SceneRecord], title: str = "") -> Iterator[Rgb]:
    """One picture per frame: colour, depth and ids of the first view of every scene."""
    span = _depth_span(records)
    for frame in range(min(record["rgb"].shape[0] for record in records.values())):
        tiles = {name: [row(frame, 0) for row in _rows(record, span).values()] for name, record in records.items()}
        blocks = [_with_heading(_beside(list(map(_enlarged, images))), name) for name, images in tiles.items()]
        yield _page(title, blocks, records)


def save_animation(path: Path, frames: list[Rgb], fps: float, palette: UInt8[np.ndarray, "color 3"]) -> None:
    """Write an MP4 if the name ends in .mp4, otherwise a GIF of the palette's colours that loops forever.

    Raises:
        UsageError: there is no codec for MP4.
    """
    if path.suffix.lower() == ".mp4":
        save_mp4(path, frames, fps)
        return
    colors = Image.new("P", (1, 1))
    colors.putpalette(palette.tobytes())
    images = [Image.fromarray(frame).quantize(palette=colors, dither=Image.Dither.FLOYDSTEINBERG) for frame in frames]
    milliseconds = min(round(1000 / fps), LONGEST // len(images))
    images[0].save(path, save_all=True, append_images=images[1:], duration=milliseconds, loop=0)


def gif_palette(records: dict[str, SceneRecord]) -> UInt8[np.ndarray, "color 3"]:
    """Choose 256 colours: steps of depth that are too fine to see, ids, text, and the rest for the colour images."""
    steps = np.linspace(0, 1000, DEPTH_STEPS).astype(np.uint16)
    fixed = [
        colored_depth(1 + steps[None], 1.0, 1001.0)[0],
        label_colors(min(_most_labels(records), LABEL_COLORS)),
        np.array([PAPER, (140, 140, 140), INK, (0, 0, 0)], np.uint8),
    ]
    pixels = np.concatenate(
        [record["rgb"][:: max(1, len(record["rgb"]) // 4)].reshape(-1, 3) for record in records.values()]
    )
    free = 256 - sum(map(len, fixed))
    palette = Image.fromarray(pixels[None]).quantize(free, Image.Quantize.MEDIANCUT).getpalette() or []
    return np.concatenate([*fixed, np.array(palette, np.uint8).reshape(-1, 3)[:free]])


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


def _title(spec: Spec) -> str:
    width, height = spec["resolution"]
    frames, views = counted(spec["recipe"]["frames"], "frame"), counted(views_of(spec), "view")
    origin = f"Recipe {spec['recipe']['name']}, seed {spec['seed']}"
    if is_imported(spec):
        origin = f"{spec['import']['source']}, imported from {spec['import']['format']}"
    return f"{origin}: {width}x{height} pixels, {frames}, {views}"


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
        raise UsageError(f"Split {scenes.name} has scenes 0 to {len(scenes) - 1}, but {wrong[0]} was requested.")
    fields = ["rgb", "depth", *(name for name in ("segmentation", "sensor_depth") if scenes.has(name))]
    fields += [name for name, field in FIELDS.items() if field.group in SIGNALS and scenes.has(name)]
    return {f"{scenes.name} scene {index}": scenes.read(index, fields) for index in indices}


def _ready(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _depth_span(records: dict[str, SceneRecord]) -> tuple[float, float]:
    """Least and greatest depth of all scenes, in stored units."""
    seen = [depth[depth > 0] for depth in (record["depth"] for record in records.values())]
    ends = [(float(np.min(depth)), float(np.max(depth))) for depth in seen if len(depth)]
    return (min(near for near, _ in ends), max(far for _, far in ends)) if ends else (0.0, 1.0)


def _most_labels(records: dict[str, SceneRecord]) -> int:
    """Number of ids in use, the background included; 0 without any masks."""
    return max(
        1 + int(np.max(record["segmentation"])) if "segmentation" in record else 0 for record in records.values()
    )


def _rows(record: SceneRecord, span: tuple[float, float]) -> dict[str, Callable[[int, int], Rgb]]:
    """Rows of the preview by name, top to bottom; each function draws its image of a frame and a view."""
    rows: dict[str, Callable[[int, int], Rgb]] = {
        "rgb": lambda frame, view: record["rgb"][frame, view],
        "depth": lambda frame, view: colored_depth(record["depth"][frame, view], *span),
    }
    if "segmentation" in record:
        rows["ids"] = lambda frame, view: colored_labels(record["segmentation"][frame, view])
    if "sensor_depth" in record:
        rows["sensor"] = lambda frame, view: colored_depth(record["sensor_depth"][frame, view], *span)
    if "flow/forward" in record:
        rows["flow"] = lambda frame, view: flow_picture(record, "forward", frame, view)
        rows["back flow"] = lambda frame, view: flow_picture(record, "backward", frame, view)
    if "normals" in record:
        rows["normals"] = lambda frame, view: colored_normals(record["normals"][frame, view])
    if "object_coordinates" in record:
        rows["coordinates"] = lambda frame, view: colored_coordinates(record["object_coordinates"][frame, view])
    if "tracks/position_2d" in record:
        rows["tracks"] = lambda frame, view: tracks_picture(record, frame, view)
    return rows


def _scene_block(record: SceneRecord, span: tuple[float, float]) -> Rgb:
    frames, views = record["rgb"].shape[:2]
    shown = sorted({0, frames // 2, frames - 1})
    images = [(frame, view) for frame in shown for view in range(views)]
    rows = _rows(record, span)
    columns = [_with_heading(_stacked([_label(name, _enlarged(record["rgb"][0, 0]).shape[0]) for name in rows]), "")]
    for frame, view in images:
        tiles = [_enlarged(row(frame, view)) for row in rows.values()]
        name = f"view {view}" if frames == 1 else f"frame {frame}" + (f", view {view}" if views > 1 else "")
        columns.append(_with_heading(_stacked(tiles), name))
    return _beside(columns)


def _page(title: str, blocks: list[Rgb], records: dict[str, SceneRecord]) -> Rgb:
    """Arrange blocks of one size below a title and above the legend."""
    picture = _grid(blocks)
    entries = list(_legend(records))
    lines: list[list[Rgb]] = [[]]
    for entry in entries:
        if lines[-1] and sum(other.shape[1] + GAP for other in lines[-1]) + entry.shape[1] > picture.shape[1] - 2 * GAP:
            lines.append([])
        lines[-1].append(entry)
    parts = [_words(title), picture, *map(_beside, lines)]
    return np.pad(_stacked(parts), ((GAP, GAP), (GAP, 0), (0, 0)), constant_values=255)


def _legend(records: dict[str, SceneRecord]) -> Iterator[Rgb]:
    """Entries of the legend: depth in metres, ids, and the colours of signals."""
    span = _depth_span(records)
    steps = np.linspace(*span, BAR)
    bar = np.repeat(colored_depth(steps[None].astype(int), *span), HEADING, axis=0)
    near, far = (f"{DEPTH_SCALE * end:.2f} m" for end in span)
    yield _beside([_words(f"depth {near}"), bar, _words(far)])
    yield _beside([_swatch((0, 0, 0)), _words("no depth")])
    for label, color in enumerate(label_colors(_most_labels(records))[:LABEL_COLORS]):
        yield _beside([_swatch(color), _words(f"id {label}" if label else "background")])
    # All scenes of a dataset store the same signals.
    for name, colors, words in signal_legend(next(iter(records.values()))):
        yield _words(name)
        yield from (_beside([_swatch(color), _words(word)]) for color, word in zip(colors[0], words, strict=True))


def _swatch(color: Sequence[int] | UInt8[np.ndarray, "3"]) -> Rgb:
    swatch = np.full((HEADING, HEADING, 3), EDGE, np.uint8)
    swatch[1:-1, 1:-1] = color
    return swatch


def _words(text: str) -> Rgb:
    return _text(text, int(_font().getlength(text)) + 3)


@functools.cache
def _font() -> "ImageFont.FreeTypeFont | ImageFont.ImageFont":
    return ImageFont.load_default(size=13)


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
    ImageDraw.Draw(paper).text(place, text, INK, _font(), anchor=anchor)
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


def _grid(blocks: list[Rgb]) -> Rgb:
    """Arrange blocks of one size in lines that are filled if possible, with a margin around each."""
    most = min(len(blocks), max(1, WIDEST // (blocks[0].shape[1] + 2 * GAP)))
    # The longest lines that leave no gap, unless they would be much shorter than the page is wide.
    full = [number for number in range(most // 2 + 1, most + 1) if len(blocks) % number == 0]
    per_line = full[-1] if full else most
    lines = [blocks[start : start + per_line] for start in range(0, len(blocks), per_line)]
    wide = [_beside([np.pad(b, ((0, GAP), (0, GAP), (0, 0)), constant_values=255) for b in line]) for line in lines]
    return _stacked(wide)


def save_mp4(path: Path, frames: Sequence[Rgb], fps: float) -> None:
    """Write a video; raises UsageError if there is no codec for MP4."""
    import imageio.v3

    # Video codecs work in blocks of 16 pixels.
    padding = [(0, -side % 16) for side in frames[0].shape[:2]]
    padded = np.stack([np.pad(frame, (*padding, (0, 0)), constant_values=255) for frame in frames])
    try:
        imageio.v3.imwrite(path, padded, plugin="FFMPEG", fps=fps)
    except (ImportError, RuntimeError) as error:
        raise UsageError(
            f"Cannot write {path.name}: there is no MP4 codec. Install one with `pip install 'obpose[video]'`, or end "
            "the name in .gif."
        ) from error
