import json
from pathlib import Path

import numpy as np
from PIL import Image

from datagen.geometry import intrinsics, look_at
from obpose.pictures import PALETTE
from obpose.rgbd.recording import Recording
from obpose.rgbd.results import SegmentedObject, label_image, overlay, write_results

WIDTH, HEIGHT = 64, 48
K = intrinsics(1.0, WIDTH, HEIGHT)
POSE = look_at(np.array([0.6, 0.0, 0.6]), np.zeros(3))
RGB = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)


def some_object(**changes: object) -> SegmentedObject:
    return SegmentedObject(
        **{"label": 1, "pixels": 5, "center": np.zeros(3), "rotation": np.eye(3), "box_size": 0.2, **changes}
    )


def labels() -> np.ndarray:
    maps = np.zeros((HEIGHT, WIDTH), np.int64)
    maps[:10, :10] = 2
    return maps


def test_a_label_image_holds_labels():
    image = label_image(labels())
    assert image.mode == "P"
    np.testing.assert_array_equal(np.asarray(image), labels())


def test_an_overlay_changes_objects_and_leaves_the_background():
    image = np.asarray(overlay(RGB, labels(), [], K, POSE))
    np.testing.assert_array_equal(image[20:], RGB[20:])
    assert (image[:10, :10] == (100 + PALETTE[2].astype(int)) // 2).all()


def drawn(**changes: object) -> np.ndarray:
    """Pixels that an overlay of one box changes."""
    image = np.asarray(overlay(RGB, np.zeros_like(labels()), [some_object(**changes)], K, POSE))
    return np.argwhere((image != RGB).any(axis=-1))


def test_a_box_is_drawn_around_its_object():
    middle, size = drawn().mean(axis=0), np.ptp(drawn(), axis=0)
    np.testing.assert_allclose(middle, [HEIGHT / 2, WIDTH / 2], atol=2)
    assert np.all(size > np.ptp(drawn(box_size=0.1), axis=0))
    assert drawn(center=np.array([0.0, 0.1, 0.0])).mean(axis=0)[1] > middle[1] + 5
    turn = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]])
    assert {tuple(place) for place in drawn(rotation=turn)} != {tuple(place) for place in drawn()}


def test_no_box_is_drawn_without_a_size_or_behind_the_camera():
    assert len(drawn(box_size=None)) == 0
    assert len(drawn(center=np.array([2.0, 0.0, 2.0]))) == 0


def test_every_frame_gets_all_its_files(tmp_path: Path):
    recording = Recording(
        (Path("a.png"), Path("b.png")), np.stack([RGB, RGB]), np.ones((2, HEIGHT, WIDTH), np.float32), K
    )
    maps = np.stack([labels(), labels()])
    page = write_results(tmp_path / "out", recording, maps, [[some_object()], []], POSE, {"world": "here"})
    facts = json.loads(page.read_text())
    assert facts["world"] == "here"
    np.testing.assert_allclose(facts["world_from_camera"], POSE, atol=1e-6)
    assert [frame["rgb"] for frame in facts["frames"]] == ["a.png", "b.png"]
    assert facts["frames"][0]["objects"] == [
        {"label": 1, "pixels": 5, "center": [0, 0, 0], "rotation": np.eye(3).tolist(), "box_size": 0.2}
    ]
    for frame in facts["frames"]:
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "out" / frame["labels"])), labels())
        assert np.asarray(Image.open(tmp_path / "out" / frame["overlay"])).shape == (HEIGHT, WIDTH, 3)
