import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sklearn.metrics import adjusted_rand_score

from obpose.contact.clip import CAUTION, MOST_OBJECTS, Image, LabelledImage, segment_clip
from obpose.contact.grouping import foreground_pairs
from tests.obpose.contact.test_grouping import affinities
from tests.worlds.sphere_clips import balls

X = np.linspace(-0.15, 0.15, 6)
HEIGHT = 0 * X + 0.045


def paths(*objects: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Centres of balls on the table, by frames and objects, from their x and y."""
    return np.stack([np.stack([x, y, HEIGHT], -1) for x, y in objects], 1)


PASSING = paths((X, 0 * X - 0.05), (-X, 0 * X + 0.05))


def clip_of(centres: np.ndarray, wrong: dict[int, np.ndarray] | None = None) -> tuple[list[Image], np.ndarray]:
    """Images of balls, and their objects; affinities follow the truth except in the frames of `wrong`."""
    clip, truth = balls(centres)
    k, pose = clip.k[0], clip.world_from_camera[0]
    v, u = np.mgrid[: truth.shape[2], : truth.shape[3]] + 0.5
    rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
    points = (rays * clip.depth[:, 0, ..., None]) @ pose[:3, :3].T + pose[:3, 3]
    labels = truth[:, 0].astype(np.int64)
    believed = {**dict(enumerate(labels)), **(wrong or {})}
    images = []
    for frame, mask in enumerate(labels > 0):
        pairs = foreground_pairs(mask, affinities(believed[frame], 2.0))
        images.append(Image(mask, points[frame], clip.rgb[frame, 0] / 255, pairs, np.zeros((mask.sum(), 1))))
    return images, labels


def undecided(image: Image, logit: float = 0.1) -> Image:
    """The image as a network sees it that hardly believes in borders of objects; `logit` is that across borders."""
    logits = image.pairs.logits
    return image._replace(pairs=image.pairs._replace(logits=np.where(logits < 0, logit, logits)))


def segmented(images: list[Image], **options: float) -> np.ndarray:
    return segment_clip(images, bias=0.0, gap=0.03, **options)


def same(found: np.ndarray, truth: np.ndarray) -> bool:
    """Whether labels are equal up to their names, over the whole clip."""
    pairs = np.unique(np.stack([found.ravel(), truth.ravel()]), axis=1)
    return pairs.shape[1] == len(np.unique(found)) == len(np.unique(truth))


@pytest.mark.parametrize("bad", [(), (0,), (2, 3)])
def test_errors_of_single_images_are_outvoted(bad: tuple[int, ...]):
    _, truth = clip_of(PASSING)
    images, truth = clip_of(PASSING, {frame: (truth[frame] > 0).astype(np.int64) for frame in bad})
    assert same(segmented(images), truth)


@pytest.mark.parametrize(("rigid", "noise"), [(True, 0.0), (False, 0.0), (False, 0.009), (False, 0.015)])
def test_motion_beyond_the_noise_decides_where_the_network_is_undecided(rigid: bool, noise: float):
    # Two balls in contact in the image; they move as one body, or the second overtakes the first. The excess residual
    # is then 32 mm: more than three standard deviations of 9 mm, but less than three of 15 mm.
    centres = paths((X if rigid else X / 2, 0 * X - 0.04), (X, 0 * X + 0.04))
    images, truth = clip_of(centres)
    found = segmented([images[0], *map(undecided, images[1:])], noise=noise)
    expected = truth > 0 if rigid or noise > 0.01 else truth
    assert len(np.unique(found)) == len(np.unique(expected))
    assert adjusted_rand_score(found[truth > 0], expected[truth > 0]) > 0.95


def test_motion_divides_what_all_images_weakly_join():
    """Two balls in contact in the image, of which the second overtakes the first."""
    images, truth = clip_of(paths((X / 2, 0 * X - 0.04), (X, 0 * X + 0.04)))
    found = segmented([undecided(image, 0.6) for image in images])
    assert found.max() == 2
    assert adjusted_rand_score(found[truth > 0], truth[truth > 0]) > 0.95


@pytest.mark.parametrize(("joined", "apart"), [((), True), ((1, 2, 3, 4), True), ((1, 2, 3, 4), False)])
def test_what_most_images_join_stays_one_object_unless_it_moves_apart(joined: tuple[int, ...], apart: bool):
    images, truth = clip_of(PASSING if apart else paths((X, 0 * X - 0.04), (X, 0 * X + 0.04)))
    labelled = [
        LabelledImage(image.mask, image.points, image.rgb, 0 * own if frame in joined else own)
        for frame, image in enumerate(images)
        for own in [truth[frame][image.mask] - 1]
    ]
    found = segment_clip(labelled, bias=-CAUTION, gap=0.03)
    expected = (truth > 0).astype(np.int64) if not apart else truth
    assert found.max() == expected.max()
    assert adjusted_rand_score(found[truth > 0], expected[truth > 0]) > 0.95


@pytest.mark.parametrize("slip", [0.0, 0.02])
def test_parts_that_turn_over_together_are_one_object_unless_they_move_apart(slip: float):
    """Two halves of an image that every frame labels apart: turned over in the second frame, slid apart in the last."""
    mask, rgb = np.ones((20, 20), bool), np.zeros((20, 20, 3))
    labels = np.tile(np.repeat([0, 1], 10), 20)
    body = np.random.default_rng(0).uniform(-1, 1, (400, 3)) * [0.03, 0.02, 0.015] + np.outer(labels, [0.06, 0, 0])
    turned = body @ Rotation.from_euler("y", 15, degrees=True).as_matrix().T
    apart = turned + np.outer(labels, [0, slip, 0])
    images = [LabelledImage(mask, points.reshape(20, 20, 3), rgb, labels) for points in (body, turned, apart)]
    found = segment_clip(images, bias=0.0, gap=0.03)
    assert len(np.unique(found)) == (1 if slip == 0 else 2)


@pytest.mark.parametrize(("count", "objects"), [(2, 2), (5, 1)])
def test_weak_doubts_of_the_network_divide_parts_at_rest_only_in_short_clips(count: int, objects: int):
    """Two halves of an image, which the network slightly prefers to divide."""
    points = np.stack([*np.mgrid[:4, :20] * 0.01, np.zeros((4, 20))], axis=-1)
    image = LabelledImage(np.ones((4, 20), bool), points, 0 * points, np.tile(np.repeat([0, 1], 10), 4))
    assert segment_clip([image] * count, bias=2.9, gap=0.03).max() == objects


@pytest.mark.parametrize("bias", [0.5, 9.0])
def test_distant_objects_are_apart_whatever_the_bias(bias: float):
    images, truth = clip_of(paths((X, 0 * X - 0.12), (-X, 0 * X + 0.12)))
    assert same(segment_clip(images, bias=bias, gap=0.03), truth)


@pytest.mark.parametrize("count", [1, 3])
def test_specks_are_background_in_noisy_images(count: int):
    mask = np.zeros((20, 20), bool)
    mask[5:12, 5:12] = mask[18, 16:18] = True
    points = np.stack([*np.mgrid[:20, :20] * 0.01, np.full((20, 20), 0.03)], axis=-1)
    points[18] += 1.0
    image = LabelledImage(mask, points, np.zeros((20, 20, 3)), np.zeros(51, np.int64))
    for noise, label in ((0.0, 1), (0.002, 0)):
        found = segment_clip([image] * count, bias=0.0, gap=0.03, noise=noise)
        assert (found[:, 18, 16:18] == label).all()
        assert (found[:, 5:12, 5:12] == 1).all()


@pytest.mark.parametrize(("count", "label"), [(2, 1), (3, 0)])
def test_distant_points_of_an_object_are_specks_unless_it_has_only_two(count: int, label: int):
    points = np.arange(3.0 * count).reshape(1, count, 3)
    image = LabelledImage(np.ones((1, count), bool), points, 0 * points, np.zeros(count, np.int64))
    assert (segment_clip([image], bias=0.0, gap=0.03, noise=0.002) == label).all()


def test_objects_that_swap_their_places_are_followed_by_their_colours():
    mask, labels = np.ones((6, 12), bool), np.tile(np.repeat([0, 1], 6), 6)
    points = np.stack([*np.mgrid[:6, :12] * 0.01, np.zeros((6, 12))], axis=-1)
    points[:, 6:, 1] += 0.06
    rgb = np.where(labels.reshape(6, 12, 1) == 0, [1.0, 0, 0], [0, 0, 1.0])
    images = [LabelledImage(mask, points, each, labels) for each in (rgb, rgb[:, ::-1])]
    found = segment_clip(images, bias=0.0, gap=0.03)
    assert np.array_equal(found[1], found[0][:, ::-1])
    assert found.max() == 2


@pytest.mark.parametrize("count", [1, 2])
def test_the_smallest_of_too_many_objects_are_background(count: int):
    labels = np.append(np.arange(400), 399)  # the last object has two pixels
    image = LabelledImage(
        np.ones((1, 401), bool),
        np.stack([np.arange(401.0), *np.zeros((2, 401))], -1)[None],
        np.zeros((1, 401, 3)),
        labels,
    )
    found = segment_clip([image] * count, bias=-CAUTION, gap=0.03)
    assert set(np.unique(found)) == set(range(MOST_OBJECTS + 1))
    assert (found[:, 0, 0] == 1).all()
    assert (found[:, 0, -2:] == MOST_OBJECTS).all()


@pytest.mark.parametrize(("views", "objects"), [(2, 1), (1, 2)])
def test_views_of_the_same_time_are_no_motion(views: int, objects: int):
    # Two balls in contact, at rest; every second image sees other points of one of them: a view, or motion.
    images, truth = clip_of(paths((0 * X, 0 * X - 0.04), (0 * X, 0 * X + 0.04))[:1])
    aside = np.where(truth[0, ..., None] == 2, [0.0, 0.02, 0.0], 0)
    both = [undecided(image) for image in (images[0], images[0]._replace(points=images[0].points + aside))]
    assert segmented(both * 2, views=views).max() == objects


def test_a_clip_without_foreground_has_no_labels():
    images, _ = clip_of(PASSING)
    empty = [clip_image._replace(mask=np.zeros_like(clip_image.mask)) for clip_image in images[:1]]
    nothing = foreground_pairs(empty[0].mask, affinities(np.zeros((64, 64), int)))
    assert not segmented([empty[0]._replace(pairs=nothing, embedding=np.zeros((0, 1)))] * 3).any()


def test_empty_frames_are_skipped():
    images, truth = clip_of(PASSING)
    mask = np.zeros_like(images[0].mask)
    nothing = foreground_pairs(mask, affinities(np.zeros(mask.shape, int)))
    images[0] = images[0]._replace(mask=mask, pairs=nothing, embedding=np.zeros((0, 1)))
    truth[0] = 0
    assert same(segmented(images), truth)


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_points_far_from_their_object_are_background_if_depth_is_noisy(noise: float):
    # One pixel of the table, far away, is taken for a piece of the ball.
    images, truth = clip_of(paths((X, 0 * X)))
    image, ball = images[2], truth[2] > 0
    away = np.linalg.norm(image.points - image.points[ball].mean(axis=0), axis=-1)
    speck = np.unravel_index(np.argmin(np.where(~ball & (away > 0.2), away, np.inf)), ball.shape)
    mask = ball.copy()
    mask[speck] = True
    alike = [
        LabelledImage(each, one.points, one.rgb, np.zeros(each.sum(), np.int64))
        for one, each in zip(images, [*(truth[:2] > 0), mask, *(truth[3:] > 0)], strict=True)
    ]
    found = segmented(alike, noise=noise)
    assert (found[2][speck] == 0) == (noise > 0)
    assert (found[truth > 0] == 1).all()
