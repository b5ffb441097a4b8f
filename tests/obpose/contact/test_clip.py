import numpy as np
import pytest

from obpose.contact.clip import Frame, segment_frames
from tests.worlds.sphere_clips import balls


def frames(groups: dict[int, np.ndarray] | None = None) -> tuple[list[Frame], np.ndarray]:
    """Two balls that pass each other, as images whose groups are the truth except where given."""
    x = np.linspace(-0.15, 0.15, 6)
    paths = np.stack(
        [np.stack([x, 0 * x - 0.05, 0 * x + 0.045], -1), np.stack([-x, 0 * x + 0.05, 0 * x + 0.045], -1)], 1
    )
    clip, truth = balls(paths)
    k, pose = clip.k[0], clip.world_from_camera[0]
    v, u = np.mgrid[: truth.shape[2], : truth.shape[3]] + 0.5
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
    points = (rays * clip.depth[:, 0, ..., None]) @ pose[:3, :3].T + pose[:3, 3]
    labels = truth[:, 0].astype(np.int64)
    shown = {**dict(enumerate(labels)), **(groups or {})}
    images = [
        Frame(labels[frame] > 0, shown[frame], points[frame], clip.rgb[frame, 0] / 255) for frame in range(len(labels))
    ]
    return images, labels


def same(found: np.ndarray, truth: np.ndarray) -> bool:
    """Whether labels are equal up to their names, over the whole clip."""
    pairs = np.unique(np.stack([found.ravel(), truth.ravel()]), axis=1)
    return pairs.shape[1] == len(np.unique(found)) == len(np.unique(truth))


def test_objects_keep_their_labels_whatever_the_names_in_single_images():
    _, truth = frames()
    swapped = {frame: np.where(truth[frame] > 0, 3 - truth[frame], 0) for frame in (1, 4)}
    images, truth = frames(swapped)
    assert same(segment_frames(images, gap=0.03), truth)


@pytest.mark.parametrize("bad", [0, 2])
def test_errors_of_a_single_image_are_outvoted(bad: int):
    _, truth = frames()
    images, truth = frames({bad: (truth[bad] > 0).astype(np.int64)})
    assert same(segment_frames(images, gap=0.03), truth)


def test_a_clip_without_foreground_has_no_labels():
    images, _ = frames()
    empty = [image._replace(mask=np.zeros_like(image.mask)) for image in images]
    assert not segment_frames(empty, gap=0.03).any()


def test_empty_frames_are_skipped():
    images, truth = frames()
    images[0] = images[0]._replace(mask=np.zeros_like(images[0].mask))
    truth[0] = 0
    assert same(segment_frames(images, gap=0.03), truth)
