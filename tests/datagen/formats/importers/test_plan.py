from pathlib import Path

import pytest

from datagen.errors import UsageError
from datagen.formats.import_request import Grouping, Request
from datagen.formats.importers.interface import Facts, Images, Recording
from datagen.formats.importers.plan import enough, plan_scenes


def recording(name: str = "a", split: str | None = None) -> Recording:
    def fail(*_: object) -> Images:
        raise AssertionError("a plan reads no images")

    return Recording(name, split, survey=fail, read=fail)


def facts(images: int = 1, *, views: int = 1, size: tuple[int, int] = (8, 6), objects: int | None = 2) -> Facts:
    return Facts(images, views, size, objects, posed=True)


def wanted(group: Grouping, **more: object) -> Request:
    return Request(format="rgbd", source=Path("a"), out=Path("b"), group=group, **more)


def splits(plan) -> dict[str, list[tuple[str, tuple[int, ...]]]]:
    return {name: [(unit.recording.name, unit.images) for unit in units] for name, units in plan.units.items() if units}


def test_long_clips_are_cut():
    plan = plan_scenes([(recording(), facts(7))], wanted("clip", frames=3, split="val"))
    assert splits(plan) == {"val": [("a", (0, 1, 2)), ("a", (3, 4, 5))]}
    assert (plan.frames, plan.views) == (3, 1)


def test_views_are_spread_evenly():
    plan = plan_scenes([(recording(), facts(60))], wanted("views", views=4))
    assert splits(plan) == {"train": [("a", (0, 15, 30, 45))]}
    assert (plan.frames, plan.views) == (1, 4)


def test_every_still_is_a_scene():
    plan = plan_scenes([(recording(), facts(2, views=3))], wanted("stills"))
    assert splits(plan) == {"train": [("a", (0,))], "test": [("a", (1,))]}
    assert (plan.frames, plan.views) == (1, 3)
    assert "same recordings" in plan.notes[0]


def test_a_note_names_splits_that_stay_empty():
    (note,) = plan_scenes([(recording(), facts(6))], wanted("clip")).notes
    assert note.startswith("No scenes for val and test.")
    assert all(flag in note for flag in ("--frames N", "--group stills", "--split test"))
    assert not plan_scenes([(recording(), facts(6))], wanted("clip", split="test")).notes
    assert not plan_scenes([(recording(split="test"), facts(6))], wanted("clip")).notes


def test_images_of_a_recording_stay_in_one_split():
    recordings = [(recording(name), facts(2)) for name in "abcd"]
    found = splits(plan_scenes(recordings, wanted("stills")))
    assert {name: {each for each, _ in units} for name, units in found.items()} == {
        "train": {"a", "d"}, "test": {"b"}, "val": {"c"},
    }  # fmt: skip


def test_splits_of_many_are_80_10_10():
    plan = plan_scenes([(recording(str(place)), facts()) for place in range(30)], wanted("clip"))
    assert {name: len(units) for name, units in plan.units.items()} == {"train": 24, "val": 3, "test": 3}


def test_scenes_without_masks_are_for_training():
    recordings = [(recording(name), facts(objects=None if name in "bd" else 3)) for name in "abcde"]
    plan = plan_scenes(recordings, wanted("clip"))
    found = splits(plan)
    assert [name for name, _ in found["train"]] == ["b", "d"]
    assert [name for name, _ in found["test"]] == ["a", "e"]
    only = splits(plan_scenes(recordings, wanted("clip", split="test")))
    assert {name: [each for each, _ in units] for name, units in only.items()} == {
        "train": ["b", "d"], "test": ["a", "c", "e"],
    }  # fmt: skip
    with pytest.raises(UsageError, match="e has masks and d has none"):
        plan_scenes(recordings, wanted("clip", split="train"))


def test_the_number_of_objects_is_that_of_the_masks_or_assumed():
    def most(masks: list[int | None], **choices: int) -> int:
        surveyed = [(recording(str(place), "train"), facts(objects=number)) for place, number in enumerate(masks)]
        return plan_scenes(surveyed, wanted("clip", **choices)).objects

    assert most([2, 5]) == 5
    assert most([None]) == 6
    assert most([None], objects=3) == 3
    assert most([4], objects=3) == 4
    assert most([0]) == 1


@pytest.mark.parametrize(
    ("one", "other", "choices", "message"),
    [
        (facts(2), facts(3), wanted("clip"), "a has 2 images and b 3; .* --frames 2"),
        (facts(2), facts(3), wanted("views"), "--views 2"),
        (facts(), facts(size=(4, 4)), wanted("clip"), "b has images of 4x4 pixels, a of 8x6; .*--resolution"),
        (facts(), facts(views=2), wanted("clip"), "b has 2 views, a 1"),
        (facts(2), facts(5), wanted("clip", frames=4), "a has 2 images, but --frames is 4"),
        (facts(900), facts(900), wanted("clip", size=(640, 480)), "at most"),
    ],
)
def test_scenes_of_different_form_are_refused(one: Facts, other: Facts, choices: Request, message: str):
    with pytest.raises(UsageError, match=message):
        plan_scenes([(recording("a"), one), (recording("b"), other)], choices)


def test_only_as_many_recordings_are_read_as_needed():
    published = [recording(str(place), "train") for place in range(50)]
    assert len(enough(published, 4)) == 4
    assert len(enough([recording(str(place)) for place in range(50)], 2)) == 20
    assert len(enough(published, None)) == 50
