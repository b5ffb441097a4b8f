import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from datagen.geometry import intrinsics, invert_rigid, look_at
from obpose.errors import UsageError
from obpose.pictures import PALETTE
from obpose.rgbd import results
from obpose.rgbd.frames import PreparedFrames, Trained, observe
from obpose.rgbd.recording import Recording
from obpose.rgbd.results import label_image, objects_of, overlay, write_results
from obpose.rgbd.workspace import Workspace
from obpose.rgbd.world import World

WIDTH, HEIGHT, SCALE = 64, 48, 5
K = intrinsics(1.0, WIDTH, HEIGHT)
POSE = look_at(np.array([0.6, 0.0, 0.6]), np.zeros(3))
RGB = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
LABELS = np.zeros((2, HEIGHT, WIDTH), np.uint8)
LABELS[:, 20:30, 20:30] = 2
LABELS[1, 0, 0] = 1


def square(low: float, high: float) -> Workspace:
    return Workspace(np.array([(low, low), (high, low), (high, high), (low, high)]), 0.004)


SQUARE = square(-0.2, 0.2)


def write(out: Path, facts: dict[str, object], *, overwrite: bool = False) -> None:
    objects = [objects_of(labels, frames().points(i)) for i, labels in enumerate(LABELS)]
    write_results(out, frames(), LABELS, objects, facts, overwrite=overwrite)


def frames(workspace: Workspace = SQUARE) -> PreparedFrames:
    recording = Recording(
        (Path("a.png"), Path("b.png")), np.stack([RGB, RGB]), np.full((2, HEIGHT, WIDTH), 0.8, np.float32), K
    )
    world = World(np.stack([POSE, POSE]), "")
    observation = observe(recording, world.poses, workspace, Trained(0.01))
    return PreparedFrames(recording, observation, world, workspace, 1, "")


def test_a_label_image_holds_labels():
    image = label_image(LABELS[0])
    assert image.mode == "P"
    np.testing.assert_array_equal(np.asarray(image), LABELS[0])


def test_objects_have_the_boxes_of_their_points():
    points = frames().points(1)
    (found,) = objects_of(LABELS[1], points)
    assert (found.label, found.pixels) == (2, 100)
    inside = (points[LABELS[1] == 2] - found.box.center) @ found.box.rotation
    assert np.mean(np.abs(inside) <= found.box.size / 2 + 1e-6) > 0.9


def test_an_overlay_shows_labels_boxes_and_the_table():
    prepared = frames()
    objects = objects_of(LABELS[0], prepared.points(0))
    image = overlay(RGB, LABELS[0], objects, prepared, 0)
    assert (image == (100 + PALETTE[2].astype(int)) // 2).all(axis=-1).sum() > 10
    assert (image == 255).all(axis=-1).sum() > 20
    # The edges of the box run around the label.
    edges = np.argwhere((image == PALETTE[2]).all(axis=-1))
    assert np.ptp(edges, axis=0).min() >= 8 * SCALE
    assert (overlay(RGB, 0 * LABELS[0], [], frames(square(2.0, 3.0)), 0) == 100).all()


def test_an_overlay_is_at_least_320_pixels_wide_and_fits_the_enlarged_image():
    image = overlay(RGB, LABELS[0], [], frames(), 0)
    assert image.shape == (HEIGHT * SCALE, WIDTH * SCALE, 3)
    tinted = (image == (100 + PALETTE[2].astype(int)) // 2).all(axis=-1)
    np.testing.assert_array_equal(np.argwhere(tinted).min(axis=0), (20 * SCALE, 20 * SCALE))
    # The outline follows the edges of the table, as they are seen by the camera.
    corners = invert_rigid(POSE)[:3, :3] @ np.pad(SQUARE.outline, ((0, 0), (0, 1))).T + invert_rigid(POSE)[:3, 3:]
    pixels = SCALE * (K @ corners)[:2] / (K @ corners)[2]
    white = np.argwhere((image == 255).all(axis=-1))
    np.testing.assert_allclose(white.max(axis=0), pixels.max(axis=1)[::-1], atol=1.5)
    wide = np.zeros((2, 640, 3), np.uint8)
    assert overlay(wide, np.zeros((2, 640), np.uint8), [], frames(square(2.0, 3.0)), 0).shape == wide.shape


def test_the_outline_of_a_table_that_goes_on_outside_follows_the_border():
    image = overlay(RGB, 0 * LABELS[0], [], frames(square(-3.0, 3.0)), 0)
    white = (image == 255).all(axis=-1)
    for side in (white[:3].T, white[-3:].T, white[:, :3], white[:, -3:]):
        assert side[3:-3].any(axis=1).all()
    assert not white[3:-3, 3:-3].any()


def test_every_frame_gets_all_its_files(tmp_path: Path):
    write(tmp_path / "out", {"world": "here"})
    facts = json.loads((tmp_path / "out" / "objects.json").read_text())
    assert facts["world"] == "here"
    np.testing.assert_allclose(facts["frames"][1]["world_from_camera"], POSE, atol=1e-6)
    assert [frame["rgb"] for frame in facts["frames"]] == ["a.png", "b.png"]
    assert np.shape(facts["table"]["outline"]) == (4, 2)
    for i, (frame, labels) in enumerate(zip(facts["frames"], LABELS, strict=True)):
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "out" / frame["labels"])), labels)
        assert np.asarray(Image.open(tmp_path / "out" / frame["overlay"])).shape == (HEIGHT * SCALE, WIDTH * SCALE, 3)
        (entry,) = frame["objects"]
        assert (entry["label"], entry["pixels"]) == (2, 100)
        (found,) = objects_of(labels, frames().points(i))
        np.testing.assert_allclose(entry["size"], found.box.size, atol=1e-6)
        cloud = trimesh.load(tmp_path / "out" / entry["cloud"])
        assert len(cloud.vertices) == 100
    assert (tmp_path / "out" / "summary.png").exists()


def test_a_video_is_an_mp4_or_without_its_codec_a_gif(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if importlib.util.find_spec("imageio_ffmpeg"):
        write(tmp_path / "mp4", {})
        assert (tmp_path / "mp4" / "overlay.mp4").read_bytes()[4:8] == b"ftyp"

    def without_codec(*_: object):
        raise UsageError("there is no MP4 codec")

    monkeypatch.setattr(results, "save_mp4", without_codec)
    write(tmp_path / "gif", {})
    with Image.open(tmp_path / "gif" / "overlay.gif") as animation:
        assert animation.n_frames == 2
    assert not (tmp_path / "gif" / "overlay.mp4").exists()


def test_only_an_earlier_result_is_replaced(tmp_path: Path):
    out = tmp_path / "out"
    write(out, {"run": 1})
    with pytest.raises(UsageError, match="not empty"):
        write(out, {"run": 2})
    write(out, {"run": 2}, overwrite=True)
    assert json.loads((out / "objects.json").read_text())["run"] == 2
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    (out / "mine").write_text("kept")
    with pytest.raises(UsageError, match="also holds mine"):
        write(out, {"run": 3}, overwrite=True)
    assert (out / "mine").read_text() == "kept"
    (out / "mine").rename(out / "clouds" / "mine")
    with pytest.raises(UsageError, match="also holds clouds/mine"):
        write(out, {"run": 3}, overwrite=True)
    (out / "clouds" / "mine").unlink()
    (out / "0009_labels.png").mkdir()
    with pytest.raises(UsageError, match=r"also holds 0009_labels\.png"):
        write(out, {"run": 3}, overwrite=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine").write_text("kept")
    with pytest.raises(UsageError, match="also holds mine"):
        write(tmp_path / "other", {}, overwrite=True)
    assert (tmp_path / "other" / "mine").read_text() == "kept"


def test_a_failed_write_leaves_the_earlier_result_alone(tmp_path: Path):
    out = tmp_path / "out"
    write(out, {"run": 1})
    with pytest.raises(TypeError):
        write(out, {"run": object()}, overwrite=True)
    assert json.loads((out / "objects.json").read_text())["run"] == 1
    with pytest.raises(TypeError):
        write(tmp_path / "new", {"run": object()})
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
