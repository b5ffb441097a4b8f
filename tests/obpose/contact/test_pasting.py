from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import fields, replace
from itertools import chain

import numpy as np
import pytest
import torch

from obpose.contact.pasting import Cutout, PastedClips, PseudoScene, cut_out, paste, pseudo_scenes
from obpose.data.clips import ArrayClips, observation_of
from obpose.errors import UsageError
from obpose.geometry import unproject
from tests.worlds.sphere_clips import balls

RADIUS = 0.045
SETTINGS = {"table": 0.0, "floor": 0.0015, "gap": 0.06, "clean": False}
SCENE = {**SETTINGS, "still": True}
BORDER = ((0, 30), (63, 30), (30, 0), (30, 63))
"""A pixel at each border of an image."""


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
    scene = next(pseudo_scenes(clips.window(0, 0, 1), **SCENE))
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


def test_every_view_has_its_own_image_and_camera():
    path = np.array([[[0.1, 0.0, RADIUS]], [[0.1, 0.1, RADIUS]]])
    views = [ArrayClips([balls(path, eye=eye)[0]]).window(0, 0, 2) for eye in ((0.01, 0.0, 1.0), (0.7, 0.0, 0.6))]
    views[1]["k"] = 0.9 * views[1]["k"]
    both = {
        name: torch.cat([view[name] for view in views], dim=0 if name in ("k", "world_from_camera") else 1)
        for name in views[0]
    }
    alone = zip(*(pseudo_scenes(view, **SCENE) for view in views), strict=True)
    for found, expected in zip(pseudo_scenes(both, **SCENE), chain(*alone), strict=True):
        for field in fields(PseudoScene):
            np.testing.assert_array_equal(getattr(found, field.name), getattr(expected, field.name))
    clips = PastedClips(source([(0.0, 0.0)]), **SETTINGS, seed=0)
    labels = np.concatenate([clips.pseudo_labels(view) for view in views], axis=1)
    np.testing.assert_array_equal(clips.pseudo_labels(both), labels)
    assert not np.array_equal(labels[:, 0], labels[:, 1])


@pytest.mark.parametrize(("size", "least"), [(64, 6), (128, 24)])
def test_pseudo_objects_have_enough_pixels_for_the_size_of_the_image(size: int, least: int):
    window = ArrayClips([balls(np.zeros((1, 0, 3)), size)[0]]).window(0, 0, 1)
    counts = []
    for last in (20 + least - 1, 20 + least):
        depth = window["depth"].clone()
        depth[..., 30, 20:last] -= 0.02
        counts.append(next(pseudo_scenes({**window, "depth": depth}, **SCENE)).count)
    assert counts == [0, 1]


def test_components_beyond_the_255th_are_no_pseudo_objects(clips: ArrayClips, monkeypatch: pytest.MonkeyPatch):
    labels = np.zeros((64, 64), np.int64)
    labels[:5] = np.arange(1, 321).reshape(5, 64)
    monkeypatch.setattr("obpose.contact.pasting.image_components", lambda *args, **settings: labels)
    found = next(pseudo_scenes(clips.window(0, 0, 1), **{**SCENE, "still": False})).labels
    np.testing.assert_array_equal(found, np.where(labels > 255, 0, labels))


def test_objects_beyond_the_255th_of_a_clip_share_a_label(clips: ArrayClips, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        "obpose.contact.pasting.track", lambda clouds, *rest: [np.full(len(cloud.points), 300) for cloud in clouds]
    )
    found = PastedClips(clips, **SETTINGS, seed=0).pseudo_labels(clips.window(0, 0, 1))
    assert np.unique(found).tolist() == [0, 255]


def test_one_to_three_objects_are_added_and_each_number_often():
    clips = source([(0.0, 0.0)])
    counts = [int(image["pseudo_labels"].max()) - 1 for image in pasted(clips, 60)]
    shares = np.bincount(counts, minlength=4) / len(counts)
    assert len(shares) == 4
    assert (shares[1:] > 0.15).all()


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
    return next(pseudo_scenes(source([(0.0, 0.0)], eye=(0.7, 0.0, 0.6)).window(0, 0, 1), **SCENE))


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


def test_objects_that_would_look_much_larger_or_smaller_are_not_pasted():
    near, far = (
        next(pseudo_scenes(source([place], eye=(0.7, 0.0, 0.6)).window(0, 0, 1), **SCENE))
        for place in ((0.25, 0.0), (-0.25, 0.0))
    )
    found = [next(pastings(*pair), None) for pair in ((near, near), (near, far), (far, near))]
    assert [pasting is not None for pasting in found] == [True, False, False]


def drawn(*pixels: tuple[slice | int, slice | int]) -> PseudoScene:
    """An image from above in random colours, in which these pixels are the only object."""
    scene = next(pseudo_scenes(source([(0.0, 0.0)]).window(0, 0, 1), **SCENE))
    labels = np.zeros_like(scene.labels)
    for rows, columns in pixels:
        labels[rows, columns] = 1
    rgb = np.random.default_rng(0).random(scene.rgb.shape).astype(np.float32)
    return replace(scene, rgb=rgb, labels=labels)


def test_half_of_the_objects_are_mirrored():
    scene = drawn((slice(20, 26), 30), (25, slice(30, 40)))  # an L
    mirrored = []
    for seed in range(100):
        cutout = cut_out(scene, np.random.default_rng(seed))
        mirrored.append(cutout.columns.mean() < 32)
        columns = 63 - cutout.columns if mirrored[-1] else cutout.columns
        assert (scene.labels[cutout.rows, columns] == 1).all()
        assert np.array_equal(cutout.rgb, scene.rgb[cutout.rows, columns])
    assert 30 < sum(mirrored) < 70


@pytest.mark.parametrize("pixel", BORDER)
def test_objects_at_a_border_of_the_image_are_not_cut_out(pixel: tuple[int, int]):
    assert cut_out(drawn(pixel), np.random.default_rng(0)) is None


@pytest.mark.parametrize("corner", [slice(2, 6), slice(58, 62)], ids=["top left", "bottom right"])
def test_objects_are_not_pasted_at_a_border_of_the_image(corner: slice):
    other = drawn((slice(30, 34), slice(30, 34)))
    for _, found in pastings(drawn((corner, corner)), other):
        assert not (found.labels[[0, -1]] == 2).any()
        assert not (found.labels[:, [0, -1]] == 2).any()


def test_objects_are_not_pasted_above_the_horizon():
    """Objects above and below the horizon of a camera that looks straight ahead."""
    level = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]], np.float32)
    found = []
    for row in (18, 42):
        scene = replace(drawn((slice(row, row + 4), slice(30, 34))), world_from_camera=level)
        near = replace(scene, depth=np.full_like(scene.depth, 0.7))
        found.append(next(pastings(scene, near), None) is not None)
    assert found == [False, True]


def test_objects_are_pasted_over_pixels_without_depth():
    scene = seen_at_an_angle()
    cutout, found = next(pastings(replace(scene, depth=0 * scene.depth), scene))
    assert np.count_nonzero(found.labels == 2) == np.count_nonzero(found.depth) == len(cutout.rows)


def test_the_background_does_not_tint_the_border_of_objects():
    scene = drawn((slice(20, 29), slice(20, 29)))
    scene.rgb[21:28, 21:28] = 0.5
    assert (cut_out(scene, np.random.default_rng(0)).rgb == 0.5).all()


def test_thin_parts_of_objects_keep_their_colours_away_from_thick_ones():
    """A square of 6 pixels with a handle of one row; the inside of the square ends in column 24."""
    scene = drawn((slice(20, 26), slice(20, 26)), (22, slice(26, 36)))
    columns = np.nonzero(scene.labels)[1]
    own = (cut_out(scene, np.random.default_rng(0)).rgb == scene.rgb[scene.labels > 0]).all(axis=1)
    assert own[columns > 26].all()
    assert not own[(columns == 25) | (columns == 26)].any()


def test_half_of_the_pasted_objects_take_the_colour_of_the_other_object():
    scene, own = seen_at_an_angle(), np.array([0.2, 0.4, 0.6], np.float32)
    other = replace(scene, rgb=0 * scene.rgb + own)
    kept = []
    for _, found in pastings(scene, other):
        colour = found.rgb[found.labels == 2].mean(axis=0)
        kept.append(np.allclose(colour, own, atol=1e-3))
        assert kept[-1] or np.allclose(colour, scene.rgb[scene.labels == 1].mean(axis=0), atol=0.1)
    assert 30 < sum(kept) < 70


def test_pasted_objects_are_visible_and_leave_others_visible():
    """Small ones are not hidden by a ball, and balls do not hide small ones."""
    scene = seen_at_an_angle()
    low = only_low(scene)
    visible = [np.count_nonzero(found.labels == 2) / len(cutout.rows) for cutout, found in pastings(scene, low)]
    assert 0.5 <= min(visible) < 0.6
    left = [np.count_nonzero(found.labels == 1) / np.count_nonzero(low.labels) for _, found in pastings(low, scene)]
    assert 0.4 <= min(left) <= 0.5


def test_pasted_objects_hide_what_is_behind_them(clips: ArrayClips):
    for index, image in enumerate(pasted(clips)):
        before = clips.window(index % 3, 0, 1)
        changed = image["depth"] != before["depth"]
        assert torch.all(image["depth"][changed] < before["depth"][changed])
        assert torch.all(image["pseudo_labels"][changed] > 0)


def adjoins(labels: np.ndarray) -> bool:
    pairs = [(labels[1:], labels[:-1]), (labels[:, 1:], labels[:, :-1])]
    return any(np.any((a != b) & (a > 0) & (b > 0)) for a, b in pairs)


def test_most_pasted_objects_touch_another_one(clips: ArrayClips):
    images = [image["pseudo_labels"][0, 0].numpy() for image in pasted(clips)]
    assert sum(map(adjoins, images)) > len(images) / 2


def test_few_objects_are_pasted_where_they_touch_none_though_most_places_are_so():
    long, small = drawn((32, slice(12, 52))), drawn((slice(30, 34), slice(30, 34)))
    touching = [adjoins(found.labels) for _, found in pastings(long, small)]
    assert 0.7 < np.mean(touching) < 1


def test_nearly_all_objects_are_pasted_though_most_places_are_refused():
    """No place between two distant pixels touches one of them. A fifth of such places are accepted.

    One of twelve places is accepted with a probability of 1 - 0.8 ** 12 = 93 %.
    """
    found = [*pastings(drawn((10, 10), (50, 50)), drawn((slice(30, 34), slice(30, 34))))]
    assert len(found) == pytest.approx(93, abs=6)
    assert not any(adjoins(each.labels) for _, each in found)


def test_nothing_is_pasted_into_images_with_many_objects():
    many = source([(x, y) for x in (-0.2, 0.0, 0.2) for y in (-0.2, 0.0, 0.2)])
    assert [int(image["pseudo_labels"].max()) for image in pasted(many, 5)] == [9] * 5


def test_the_image_with_the_most_objects_is_used():
    apart = np.array([[[-0.15, 0, RADIUS], [0.15, 0, RADIUS]]])
    together = np.array([[[-0.04, 0, RADIUS], [0.04, 0, RADIUS]]])
    clips = ArrayClips([balls(np.concatenate([together, apart, together]))[0]])
    assert [scene.count for scene in pseudo_scenes(clips.window(0, 0, 3), **SCENE)] == [1, 2, 1]
    assert PastedClips(clips, **SETTINGS, seed=0)._scene(0).count == 2


def test_pseudo_objects_are_followed_from_the_frame_that_shows_the_most():
    """Two balls touch in the first and the last frame."""
    paths = np.array([[[-place, 0, RADIUS], [place, 0, RADIUS]] for place in (0.04, 0.08, 0.04)])
    clip, truth = balls(paths)
    clips = ArrayClips([clip])
    assert [scene.count for scene in pseudo_scenes(clips.window(0, 0, 3), **SCENE)] == [1, 2, 1]
    labels = PastedClips(clips, **SETTINGS, seed=0).pseudo_labels(clips.window(0, 0, 3))
    both = (labels > 0) & (truth > 0)
    assert {*zip(truth[both].tolist(), labels[both].tolist(), strict=True)} == {(1, 1), (2, 2)}


def test_narrow_holes_do_not_divide_objects_and_belong_to_them_only_if_cleaned():
    clips = source([(-RADIUS, 0.0), (RADIUS, 0.0)])
    image = clips.window(0, 0, 1)
    labels = next(pseudo_scenes(image, **SCENE)).labels
    longer = int(np.argmax([np.ptp(np.nonzero(labels)[axis]) for axis in (0, 1)]))
    middle = round(np.nonzero(labels)[longer].mean())
    for width, count in ((2, 1), (4, 2)):
        hole = [slice(None), slice(None)]
        hole[longer] = slice(middle - width // 2, middle + width // 2)
        valid = image["valid"].clone()
        valid[0, 0][tuple(hole)] = False
        holed = {**image, "valid": valid, "depth": image["depth"] * valid}
        found = next(pseudo_scenes(holed, **SCENE))
        filled = next(pseudo_scenes(holed, **{**SCENE, "clean": True}))
        assert found.count == filled.count == count
        # Only in cleaned images those pixels belong to objects that have a neighbour outside.
        ball = labels[tuple(hole)] > 0
        for scene, expected in ((found, False), (filled, True)):
            for values in (scene.labels, scene.depth):
                assert values[tuple(hole)][ball].any() == expected
        assert filled.labels[tuple(hole)][ball].all() == (width == 2)
        for clean in (False, True):
            of_clip = PastedClips(clips, **{**SETTINGS, "clean": clean}, seed=0).pseudo_labels(holed)
            assert of_clip[0, 0].max() == count
            assert not of_clip[0, 0][tuple(hole)].any()


def test_pixels_without_depth_connect_no_objects():
    """They lie nowhere, not in the origin of the world, which is above this table."""
    window = source([(-0.1, 0.0), (0.1, 0.0)]).window(0, 0, 1)
    objects = torch.from_numpy(next(pseudo_scenes(window, **SCENE)).labels > 0)
    holed = {**window, "valid": window["valid"] & objects, "depth": window["depth"] * objects}
    holed["world_from_camera"][:, 2, 3] -= 0.4
    assert next(pseudo_scenes(holed, **{**SCENE, "table": -0.4, "gap": 1.0})).count == 2


def test_objects_stand_on_the_table_at_any_height():
    image = source([(-0.15, 0.05), (0.1, -0.1)]).window(0, 0, 1)
    raised = {**image, "world_from_camera": image["world_from_camera"].clone()}
    raised["world_from_camera"][:, 2, 3] += 0.3
    one, other = (
        next(pseudo_scenes(window, **{**SCENE, "table": table})).labels
        for window, table in ((image, 0.0), (raised, 0.3))
    )
    assert one.max() == 2
    assert np.array_equal(one, other)


def test_pseudo_objects_that_lie_in_a_hole_are_left_out(clips: ArrayClips, monkeypatch: pytest.MonkeyPatch):
    window = clips.window(0, 0, 1)
    window["valid"][..., 2, 3] = False
    labels = np.zeros((64, 64), np.int64)
    labels[2, 3], labels[30:33, 30] = 1, 2
    monkeypatch.setattr("obpose.contact.pasting.image_components", lambda *args, **settings: labels)
    scene = next(pseudo_scenes(window, **SCENE))
    assert (scene.count, np.count_nonzero(scene.labels == 1)) == (1, 3)


@pytest.mark.parametrize(("frames", "count"), [(1, 1), (2, 2)], ids=["a still", "a clip"])
def test_a_ball_above_another_belongs_to_it_only_in_stills(frames: int, count: int):
    places = np.repeat([[(0.0, 0.0, RADIUS), (0.0, 0.0, 0.3)]], frames, axis=0)
    clip = balls(places, eye=(0.7, 0.0, 0.3))[0]
    clip.world_from_camera[:, 2, 3] -= 0.4
    clips = ArrayClips([clip])
    found = PastedClips(clips, **{**SETTINGS, "table": -0.4}, seed=0).pseudo_labels(clips.window(0, 0, frames))
    assert found.max() == count


@pytest.mark.parametrize("clean", [False, True])
def test_noise_is_smoothed_only_in_cleaned_images(clean: bool):
    image = source([(0.0, 0.0)]).window(0, 0, 1)
    noisy = image["depth"] + 0.002 * torch.randn(image["depth"].shape, generator=torch.Generator().manual_seed(0))
    found = next(pseudo_scenes({**image, "depth": noisy}, **{**SCENE, "floor": 0.01, "clean": clean}))
    error = np.std(found.depth - image["depth"][0, 0].numpy())
    assert error == pytest.approx(0.001 if clean else 0.002, abs=0.0005)


@pytest.mark.parametrize(
    ("balls", "table"), [([], 0.0), ([(0.0, 0.0)], -0.002)], ids=["nothing", "the table counts as an object"]
)
def test_clips_that_show_no_whole_object_are_refused(balls: list[tuple[float, float]], table: float):
    with pytest.raises(UsageError, match=r"--set model\.table"):
        PastedClips(source(balls, balls), **{**SETTINGS, "table": table}, seed=0).check()


@pytest.mark.parametrize("pixel", BORDER)
def test_objects_at_a_border_of_the_image_are_not_whole(pixel: tuple[int, int], monkeypatch: pytest.MonkeyPatch):
    labels = np.zeros((64, 64), np.int64)
    labels[pixel] = 1
    monkeypatch.setattr("obpose.contact.pasting.image_components", lambda *args, **settings: labels)
    with pytest.raises(UsageError, match="show no whole object"):
        PastedClips(source([]), **SETTINGS, seed=0).check()


@pytest.mark.parametrize("checked", [1, 2])
def test_one_of_some_clips_spread_evenly_must_show_an_object(checked: int, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("obpose.contact.pasting.CHECKED", checked)
    with nullcontext() if checked == 2 else pytest.raises(UsageError, match="show no whole object"):
        PastedClips(source([], [], [(0.0, 0.0)]), **SETTINGS, seed=0).check()


def test_clips_without_objects_neither_get_nor_give_any():
    images = pasted(source([], [(0.0, 0.0)]), 10)
    assert not any(image["pseudo_labels"].any() for image in images[::2])
    assert all(image["pseudo_labels"].any() for image in images[1::2])


def test_only_single_frames_are_given(clips: ArrayClips):
    with pytest.raises(UsageError, match=r"train\.frames=1"):
        PastedClips(clips, **SETTINGS, seed=0).window(0, 0, 2)
