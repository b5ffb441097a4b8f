from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

from obpose.contact.pasting import (
    LEAST_LEFT,
    LEAST_VISIBLE,
    Cutout,
    PastedClips,
    PseudoScene,
    cut_out,
    paste,
    pseudo_scenes,
)
from obpose.data.clips import ArrayClips, observation_of
from obpose.errors import UsageError
from obpose.geometry import unproject
from tests.worlds.sphere_clips import balls

RADIUS = 0.045
SETTINGS = {"table": 0.0, "floor": 0.0015, "gap": 0.06, "clean": False}


def source(*scenes: Sequence[tuple[float, float]], **options: tuple[float, float, float]) -> ArrayClips:
    """Clips of one frame with balls on the table at these places."""
    paths = [np.array([[(*place, RADIUS) for place in scene]], dtype=float).reshape(1, -1, 3) for scene in scenes]
    return ArrayClips([balls(path, **options)[0] for path in paths])


@pytest.fixture(scope="module")
def clips() -> ArrayClips:
    return source([(0.0, 0.0)], [(0.1, 0.1)], [(-0.15, 0.05), (0.1, -0.1)])


def pasted(clips: ArrayClips, count: int = 20, **options: int) -> list[dict[str, torch.Tensor]]:
    made = PastedClips(clips, **SETTINGS, seed=3, **options)
    return [made.window(index % len(clips), start, 1) for start, index in enumerate(range(count))]


def test_images_depend_only_on_seed_clip_and_number(clips: ArrayClips):
    one, other = pasted(clips), pasted(clips)
    for name in one[0]:
        assert all(torch.equal(a[name], b[name]) for a, b in zip(one, other, strict=True))
    labels = torch.stack([image["pseudo_labels"] for image in one[::3]])
    assert len(labels.unique(dim=0)) > 3


def test_pseudo_objects_are_found_again_when_their_memory_is_used_up(clips: ArrayClips, monkeypatch):
    scene = next(pseudo_scenes(clips.window(0, 0, 1), **SETTINGS))
    read: list[int] = []
    window = ArrayClips.window
    monkeypatch.setattr(
        ArrayClips, "window", lambda self, index, *rest: read.append(index) or window(self, index, *rest)
    )
    kept, images = [], []
    for count in (len(clips), 1):
        images.append(pasted(clips, kept_bytes=count * scene.bytes))
        kept.append(len(read) - sum(kept))
    assert kept[0] == len(clips) < kept[1]
    assert all(torch.equal(a["rgb"], b["rgb"]) for a, b in zip(*images, strict=True))


def test_objects_are_added_to_those_that_are_there(clips: ArrayClips):
    counts = [int(image["pseudo_labels"].max()) for image in pasted(clips)]
    own = [1, 1, 2]
    assert all(count >= own[index % 3] for index, count in enumerate(counts))
    assert max(counts) >= 4


def test_pasted_balls_stand_on_the_table_and_keep_their_size(clips: ArrayClips):
    for image in pasted(clips):
        points = unproject(observation_of([image]))[0, 0, 0]
        for name in range(1, int(image["pseudo_labels"].max()) + 1):
            height = points[image["pseudo_labels"][0, 0] == name][:, 2]
            assert height.max() < 2 * RADIUS + 0.012  # the top of a ball, of which some pixels may be hidden
            assert height.min() > -0.012


def seen_at_an_angle() -> PseudoScene:
    """A ball in front of a camera from which farther places on the table look higher."""
    return next(pseudo_scenes(source([(0.0, 0.0)], eye=(0.7, 0.0, 0.6)).window(0, 0, 1), **SETTINGS))


def only_low(scene: PseudoScene) -> PseudoScene:
    """The lowest rows of the ball as the object."""
    rows = np.nonzero(scene.labels)[0]
    return replace(scene, labels=np.where(np.arange(64)[:, None] > rows.max() - 3, scene.labels, 0).astype(np.uint8))


def pastings(scene: PseudoScene, other: PseudoScene) -> Iterator[tuple[Cutout, PseudoScene]]:
    for seed in range(100):
        rng = np.random.default_rng(seed)
        cutout = cut_out(other, rng)
        found = paste(scene, cutout, rng)
        if found is not scene:
            yield cutout, found


def test_pasted_objects_keep_their_height_though_they_are_farther_away_or_nearer():
    scene, moved = seen_at_an_angle(), []
    for cutout, found in pastings(scene, scene):
        mask = found.labels == 2
        if np.count_nonzero(mask) == len(cutout.rows):
            assert found.points(mask)[:, 2].mean() == pytest.approx(cutout.height, abs=0.003)
            moved.append(abs(found.depth[mask].mean() / cutout.depth.mean() - 1))
    assert max(moved) > 0.05


def test_pasted_objects_are_visible_and_leave_others_visible():
    """Small ones are not hidden by a ball, and balls do not hide small ones."""
    scene = seen_at_an_angle()
    low = only_low(scene)
    visible = [np.count_nonzero(found.labels == 2) / len(cutout.rows) for cutout, found in pastings(scene, low)]
    assert LEAST_VISIBLE <= min(visible) < 1
    left = [np.count_nonzero(found.labels == 1) / np.count_nonzero(low.labels) for _, found in pastings(low, scene)]
    assert LEAST_LEFT <= min(left) < 1


def test_pasted_objects_hide_what_is_behind_them(clips: ArrayClips):
    for index, image in enumerate(pasted(clips)):
        before = clips.window(index % 3, 0, 1)
        changed = image["depth"] != before["depth"]
        assert torch.all(image["depth"][changed] < before["depth"][changed])
        assert torch.all(image["pseudo_labels"][changed] > 0)


def test_most_pasted_objects_touch_another_one(clips: ArrayClips):
    def adjoins(labels: np.ndarray) -> bool:
        pairs = [(labels[1:], labels[:-1]), (labels[:, 1:], labels[:, :-1])]
        return any(np.any((a != b) & (a > 0) & (b > 0)) for a, b in pairs)

    images = [image["pseudo_labels"][0, 0].numpy() for image in pasted(clips)]
    assert sum(map(adjoins, images)) > len(images) / 2


def test_the_image_with_the_most_objects_is_used():
    apart = np.array([[[-0.15, 0, RADIUS], [0.15, 0, RADIUS]]])
    together = np.array([[[-0.04, 0, RADIUS], [0.04, 0, RADIUS]]])
    clips = ArrayClips([balls(np.concatenate([together, apart, together]))[0]])
    assert [scene.count for scene in pseudo_scenes(clips.window(0, 0, 3), **SETTINGS)] == [1, 2, 1]
    image = PastedClips(clips, **SETTINGS, seed=0).window(0, 0, 1)
    assert int(image["pseudo_labels"].max()) >= 2


def test_narrow_holes_do_not_divide_objects_and_belong_to_them_only_if_cleaned():
    clips = source([(-RADIUS, 0.0), (RADIUS, 0.0)])
    image = clips.window(0, 0, 1)
    labels = next(pseudo_scenes(image, **SETTINGS)).labels
    longer = int(np.argmax([np.ptp(np.nonzero(labels)[axis]) for axis in (0, 1)]))
    middle = round(np.nonzero(labels)[longer].mean())
    for width, count in ((2, 1), (4, 2)):
        hole = [slice(None), slice(None)]
        hole[longer] = slice(middle - width // 2, middle + width // 2)
        valid = image["valid"].clone()
        valid[0, 0][tuple(hole)] = False
        holed = {**image, "valid": valid, "depth": image["depth"] * valid}
        found = next(pseudo_scenes(holed, **SETTINGS))
        filled = next(pseudo_scenes(holed, **{**SETTINGS, "clean": True}))
        assert found.count == filled.count == count
        # Only in cleaned images those pixels belong to objects that have a neighbour outside.
        ball = labels[tuple(hole)] > 0
        for scene, expected in ((found, False), (filled, True)):
            for values in (scene.labels, scene.depth):
                assert values[tuple(hole)][ball].any() == expected
        assert filled.labels[tuple(hole)][ball].all() == (width == 2)
        of_clip = PastedClips(clips, **SETTINGS, seed=0).pseudo_labels(holed)
        assert of_clip[0, 0].max() == count
        assert not of_clip[0, 0][tuple(hole)].any()


@pytest.mark.parametrize("clean", [False, True])
def test_noise_is_smoothed_only_in_cleaned_images(clean: bool):
    image = source([(0.0, 0.0)]).window(0, 0, 1)
    noisy = image["depth"] + 0.002 * torch.randn(image["depth"].shape, generator=torch.Generator().manual_seed(0))
    found = next(pseudo_scenes({**image, "depth": noisy}, **{**SETTINGS, "floor": 0.01, "clean": clean}))
    error = np.std(found.depth - image["depth"][0, 0].numpy())
    assert error == pytest.approx(0.001 if clean else 0.002, abs=0.0005)


def test_clips_that_show_nothing_are_refused():
    with pytest.raises(UsageError, match="nothing more than"):
        PastedClips(source([], []), **SETTINGS, seed=0)


def test_only_single_frames_are_given(clips: ArrayClips):
    with pytest.raises(UsageError, match=r"train\.frames=1"):
        PastedClips(clips, **SETTINGS, seed=0).window(0, 0, 2)
