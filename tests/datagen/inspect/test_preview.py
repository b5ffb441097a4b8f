import contextlib
import importlib.util
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datagen.errors import UsageError
from datagen.inspect import preview, signal_pictures
from datagen.schema import SIGNALS
from datagen.storage import spec
from datagen.storage.shard import pack
from tests.worlds import rendered


def test_the_sheet_shows_the_pixels_of_first_middle_and_last_frame(tiny_dataset: Path, tmp_path: Path):
    sheet, animation = preview.run(
        tiny_dataset, scenes=(0, 2), out=tmp_path / "new" / "sheet.png", video=tmp_path / "clips.gif"
    )
    picture = np.asarray(Image.open(sheet))
    chosen = preview._chosen(preview.Dataset(tiny_dataset).split("train"), [0, 2])
    for record in chosen.values():
        for frame in (0, 2, 3):
            assert contains(picture, np.repeat(np.repeat(record["rgb"][frame, 0], 3, axis=0), 3, axis=1))
    with Image.open(animation) as clip:
        assert clip.n_frames == 4  # pyright: ignore[reportAttributeAccessIssue]


def contains(picture: np.ndarray, part: np.ndarray) -> bool:
    return any(True for _ in places_of(picture, part))


def swatch(color: np.ndarray | tuple[int, ...]) -> np.ndarray:
    """A colour of the legend, with its grey edge."""
    square = np.full((18, 18, 3), 150, np.uint8)
    square[1:-1, 1:-1] = color
    return square


def places_of(picture: np.ndarray, part: np.ndarray) -> Iterator[tuple[int, int]]:
    """Rows and columns of the places where a picture shows a part."""
    height, width = part.shape[:2]
    rows, columns = picture.shape[0] - height + 1, picture.shape[1] - width + 1
    # A few pixels rule out most places.
    fits = np.ones((rows, columns), bool)
    for y, x in zip(np.linspace(0, height - 1, 12, dtype=int), np.linspace(0, width - 1, 12, dtype=int), strict=True):
        fits &= np.all(picture[y : y + rows, x : x + columns] == part[y, x], axis=-1)
    for y, x in np.argwhere(fits).tolist():
        if np.array_equal(picture[y : y + height, x : x + width], part):
            yield y, x


def test_views_stand_side_by_side_and_stills_have_no_animation(tmp_path: Path):
    record = rendered.record(rendered.scene(views=3, frames=1), resolution=(160, 120), sensor=True)
    folder = rendered.write_dataset(tmp_path / "stills", [record], sensor=True)
    (sheet,) = preview.run(folder, scenes=(0,))
    assert sheet == folder / "preview.png"
    picture = np.asarray(Image.open(sheet))
    for view in range(3):
        assert contains(picture, record["rgb"][0, view])
        assert contains(picture, preview.colored_labels(record["segmentation"][0, view]))
    assert picture.shape[0] > 4 * 120


def test_signals_are_shown_below_the_images(tmp_path: Path):
    record = rendered.record(rendered.scene(frames=2), resolution=(160, 120), signals=SIGNALS)
    folder = rendered.write_dataset(tmp_path / "signals", [record])
    facts = spec.with_splits({**spec.read_spec(folder), "with": [*SIGNALS]}, {"train": 1})
    (folder / spec.SPEC_FILE).write_text(spec.spec_text(facts))
    rendered.write_shard(folder, facts, "train", 0, [pack(record)])
    picture = np.asarray(Image.open(preview.run(folder, out=tmp_path / "sheet.png")[0]))
    for frame in range(2):
        assert contains(picture, signal_pictures.colored_normals(record["normals"][frame, 0]))
        assert contains(picture, signal_pictures.colored_coordinates(record["object_coordinates"][frame, 0]))
        assert contains(picture, signal_pictures.tracks_picture(record, frame, 0))
        for direction in ("forward", "backward"):
            assert contains(picture, signal_pictures.flow_picture(record, direction, frame, 0))
    # The legend has a colour for flow to the right, shown and hidden, for still points, also white on white, for images
    # without flow, for normals that point up, and for coordinate z.
    for color in [(255, 0, 0), (127, 0, 0), (255, 255, 255), (127, 127, 127), (127, 255, 127), (0, 0, 255)]:
        assert contains(picture, swatch(color))


def test_colours_of_signals_tell_directions():
    right, left, still = signal_pictures.colored_flow(np.array([[[9.0, 0.0], [-9.0, 0.0], [0.0, 0.0]]]), 9.0)[0]
    assert right.tolist() == [255, 0, 0]
    assert left[0] == 0
    assert still.tolist() == [255, 255, 255]
    # Camera axes: x right, y down, z away from the camera.
    normals = np.array([[[32767, 0, 0], [0, -32767, 0], [0, 0, -32767], [0, 0, 0]]], np.int16)
    assert signal_pictures.colored_normals(normals)[0].tolist() == [
        [255, 127, 127], [127, 255, 127], [127, 127, 255], [0, 0, 0],
    ]  # fmt: skip


def test_only_the_files_that_are_named_are_written(tmp_path: Path):
    folder = rendered.write_dataset(tmp_path / "clips", [rendered.record(rendered.scene(frames=2))])
    before = set(folder.iterdir())
    for named in ({"out": tmp_path / "sheet.png"}, {"video": tmp_path / "clip.gif"}):
        assert preview.run(folder, **named) == [*named.values()]
        assert set(folder.iterdir()) == before
    assert preview.run(folder) == [folder / "preview.png", folder / "preview.gif"]


def test_colours_tell_near_from_far_and_ids_apart():
    depth = preview.colored_depth(np.array([[0, 1000, 1500, 2000]], np.uint16), 1000.0, 2000.0)[0].astype(int)
    assert np.all(depth[0] == 0)
    assert np.all(np.diff(np.sum(depth[1:], axis=1)) < 0)
    colors = preview.label_colors(11).astype(int)
    distances = np.abs(colors[:, None] - colors).sum(axis=-1) + 1000 * np.eye(11, dtype=int)
    assert np.min(distances) > 60


def test_requests_that_cannot_be_met_say_why(tiny_dataset: Path, tmp_path: Path):
    with pytest.raises(UsageError, match="scenes 0 to 3"):
        preview.run(tiny_dataset, scenes=(4,), out=tmp_path / "sheet.png")


def test_the_default_is_what_is_there(tiny_dataset: Path, tmp_path: Path):
    record = rendered.record(rendered.scene(frames=1), resolution=(48, 48))
    few = rendered.write_dataset(tmp_path / "few", [record, record])
    (sheet,) = preview.run(few)
    assert np.array_equal(np.asarray(Image.open(sheet)), np.asarray(Image.open(preview.run(few, scenes=(0, 1))[0])))
    copy = Path(shutil.copytree(tiny_dataset, tmp_path / "copy"))
    only_val = spec.with_splits(spec.read_spec(copy), {"val": 2})
    (copy / spec.SPEC_FILE).write_text(spec.spec_text(only_val))
    sheets = [preview.run(copy, split=split, out=tmp_path / f"{split}.png")[0] for split in (None, "val")]
    assert sheets[0].read_bytes() == sheets[1].read_bytes()
    with pytest.raises(UsageError, match="no scene of split train; choose from val"):
        preview.run(copy, split="train")


def test_no_scenes_and_other_endings_are_refused_before_anything_is_drawn(tiny_dataset: Path, tmp_path: Path):
    with pytest.raises(UsageError, match="No scene is named"):
        preview.run(tiny_dataset, scenes=(), out=tmp_path / "sheet.png")
    for name in ("sheet.xyz", "sheet", "sheet.gif"):
        with pytest.raises(UsageError, match=r"\.png or \.jpg"):
            preview.run(tiny_dataset, out=tmp_path / name)
    with pytest.raises(UsageError, match=r"\.gif or \.mp4"):
        preview.run(tiny_dataset, out=tmp_path / "sheet.png", video=tmp_path / "clip.avi")
    assert list(tmp_path.iterdir()) == []


def test_mp4_is_written_or_refused_with_the_remedy(tiny_dataset: Path, tmp_path: Path):
    target = tmp_path / "clip.mp4"
    has_codec = importlib.util.find_spec("imageio_ffmpeg") is not None
    expected = contextlib.nullcontext() if has_codec else pytest.raises(UsageError, match="pip install")
    with expected:
        preview.run(tiny_dataset, scenes=(0,), out=tmp_path / "sheet.png", video=target)
    assert target.exists() == has_codec


def test_a_dataset_without_one_of_the_images_is_one_clear_error(tmp_path: Path):
    record = rendered.record(rendered.scene(frames=2))
    folder = rendered.write_dataset(tmp_path / "staged", [record])
    del record["depth"]
    rendered.write_shard(folder, spec.read_spec(folder), "train", 0, [pack(record)])
    with pytest.raises(UsageError, match="no field 'depth'"):
        preview.run(folder)


def test_depth_in_a_gif_has_no_bands_and_ids_keep_their_colours(tmp_path: Path):
    depth = np.tile(np.arange(9000, 9000 + 64 * 40, 40, dtype=np.uint16)[:, None], (1, 1, 1, 64)).reshape(1, 1, 64, 64)
    rgb = np.random.default_rng(0).integers(0, 256, (1, 1, 64, 64, 3), dtype=np.uint8)
    labels = np.zeros((1, 1, 64, 64), np.uint8)
    labels[..., 32:] = 3
    records = {"scene": {"rgb": rgb, "depth": depth, "segmentation": labels}}
    (frame,) = preview.animation_frames(records)
    preview.save_animation(tmp_path / "a.gif", [frame], 1.0, preview.gif_palette(records))
    with Image.open(tmp_path / "a.gif") as picture:
        stored = np.asarray(picture.convert("RGB")).astype(int)
    rows = preview._rows(records["scene"], preview._depth_span(records))
    wanted = {name: preview._enlarged(rows[name](0, 0)) for name in ("depth", "ids")}
    for name, image in wanted.items():
        y, x = next(places_of(frame, image))
        found = stored[y : y + image.shape[0], x : x + image.shape[1]]
        assert np.percentile(np.abs(found - image), 99) <= 8, name
    y, x = next(places_of(frame, wanted["depth"]))
    assert len(np.unique(stored[y : y + wanted["depth"].shape[0], x + 90], axis=0)) > 50


@pytest.mark.parametrize(("number", "lines"), [(1, 1), (4, 2), (5, 2), (6, 2), (7, 3)])
def test_scenes_fill_the_grid(number: int, lines: int):
    blocks = [np.zeros((10, 600, 3), np.uint8)] * number
    assert preview._grid(blocks).shape[0] == lines * (10 + preview.GAP) + (lines - 1) * preview.GAP


def test_the_sheet_has_a_title_and_a_legend_below():
    record = rendered.record(rendered.scene(frames=1), resolution=(48, 48))
    plain, titled = (preview.contact_sheet({"scene": record}, title) for title in ("", "A title"))
    assert plain.shape == titled.shape
    rows = np.flatnonzero(np.any(plain != titled, axis=(1, 2)))
    assert 0 < rows[0] <= rows[-1] < preview.GAP + preview.HEADING
    for label in range(1 + int(record["segmentation"].max())):
        assert contains(plain, swatch(preview.label_colors(label + 1)[label]))


BLACK = np.zeros((2, 3), np.uint8)


@pytest.mark.parametrize(("fps", "frames"), [(0.001, 2), (0.001, 1), (1.0, 700)])
def test_slow_and_long_clips_fit_into_a_gif(tmp_path: Path, fps: float, frames: int):
    preview.save_animation(tmp_path / "slow.gif", [np.zeros((4, 4, 3), np.uint8)] * frames, fps, BLACK)
    with Image.open(tmp_path / "slow.gif") as clip:
        assert clip.size == (4, 4)
