import pytest

from datagen.commands import options
from datagen.config import load_recipe
from datagen.errors import UsageError
from datagen.schema import EDITS


def test_sizes_are_width_by_height():
    assert options.parse_resolution("320x240") == (320, 240)


@pytest.mark.parametrize("text", ["64", "64x", "x64", "64x64x3", "-64x64", "0x0", "7x64", "64x99999", "64 x 64", ""])
def test_a_bad_size_says_what_was_expected(text: str):
    with pytest.raises(UsageError, match="--resolution"):
        options.parse_resolution(text)


def test_splits_come_from_one_number_or_from_names():
    assert options.parse_splits(10, None) == {"train": 8, "val": 1, "test": 1}
    assert options.parse_splits(None, "train=2000,val=100,test=300") == {"train": 2000, "val": 100, "test": 300}
    assert options.parse_splits(None, "test=3") == {"test": 3}


@pytest.mark.parametrize(
    ("scenes", "split"),
    [
        (None, None),
        (10, "train=1"),
        (0, None),
        (-3, None),
        (None, "train=-1"),
        (None, "train"),
        (None, "train=1,"),
        (None, "train=1,,val=2"),
        (None, "train=1 val=2"),
        (None, "train=1,train=2"),
        (None, "training=5"),
        (None, "train=0"),
        (None, ""),
    ],
)
def test_bad_splits_say_what_was_expected(scenes, split):
    with pytest.raises(UsageError, match="--s"):
        options.parse_splits(scenes, split)


def test_shares_count_from_zero():
    assert options.parse_share(None) == (0, 1)
    assert options.parse_share("3/4") == (3, 4)


@pytest.mark.parametrize("text", ["4/4", "3/2", "-1/2", "1", "0/0", "a/b", ""])
def test_a_bad_share_says_what_was_expected(text: str):
    with pytest.raises(UsageError, match="i/n"):
        options.parse_share(text)


def test_workers_default_to_the_cores():
    assert options.parse_workers(None) >= 1
    assert options.parse_workers(3) == 3
    with pytest.raises(UsageError, match="--workers 0"):
        options.parse_workers(0)


def test_the_recipe_follows_from_video_where_none_is_named():
    assert options.choose_recipe(None, video=True).name == "moving"
    assert options.choose_recipe(None, video=False).name == "static"
    assert options.choose_recipe("noisy", video=True).name == "noisy"


def test_stills_and_video_contradict_each_other():
    with pytest.raises(UsageError, match="--video contradicts --recipe static"):
        options.choose_recipe("static", video=True)


def test_mixed_notes_what_the_command_line_names():
    flags = ["--recipe", "mixed", "--appearance.one-hue-share=0.0", "--lighting.no-shadows", "--frames", "10"]
    noted = options.with_overrides(load_recipe("mixed"), [*flags, "--resolution", "64x64", "--scenes", "3"])
    assert set(noted.overrides) == {"frames", "appearance.one_hue_share", "lighting.shadows"}
    assert noted.for_scene(1).appearance.one_hue_share == 0.0


def test_recipes_without_parts_note_nothing():
    assert options.with_overrides(load_recipe("moving"), ["--frames", "10"]) == load_recipe("moving")


def test_names_have_one_order_and_no_others_are_known():
    assert options.parse_names("--edits", "add,remove", EDITS) == ("remove", "add")
    assert options.parse_names("--edits", None, EDITS) == ()
    for text in ("", "remove,", "recolour", "remove move"):
        with pytest.raises(UsageError, match=r"--edits .*expected some of remove,move,add"):
            options.parse_names("--edits", text, EDITS)


HUGE = "9" * 5000
"""More digits than Python reads as a number."""


@pytest.mark.parametrize(
    ("parse", "text", "limit"),
    [
        (options.parse_resolution, "4097x64", "from 8 to 4096"),
        (options.parse_resolution, f"{HUGE}x64", "from 8 to 4096"),
        (options.parse_resolution, "٦٤x٦٤", "width x height"),
        (options.parse_share, "0/100001", "n is at most 100,000"),
        (options.parse_share, f"0/{HUGE}", "n is at most 100,000"),
        (options.parse_share, f"{HUGE}/{HUGE}", "n is at most 100,000"),
        (options.parse_workers, 10**6, "at most"),
        (options.parse_workers, 10**4000, "at most"),
        (options.check_seed, 2**63, "at most 9223372036854775807"),
        (options.check_seed, 10**4000, "at most 9223372036854775807"),
        (options.check_seed, -1, "expected 0 or more"),
        (lambda scenes: options.parse_splits(scenes, None), 10**12, "at most 1,000,000"),
        (lambda scenes: options.parse_splits(scenes, None), 10**4000, "at most 1,000,000"),
        (lambda split: options.parse_splits(None, split), "train=1000000000000000000", "at most 1,000,000 scenes"),
        (lambda split: options.parse_splits(None, split), f"val=1,test={HUGE}", "at most 1,000,000 scenes"),
    ],
)
def test_numbers_beyond_all_reason_are_refused_with_the_limit(parse, text, limit: str):
    with pytest.raises(UsageError, match=limit) as refused:
        parse(text)
    assert len(str(refused.value)) < 300


def test_the_limits_themselves_are_accepted():
    assert options.parse_resolution("8x4096") == (8, 4096)
    assert options.parse_share("99999/100000") == (99_999, 100_000)
    assert options.parse_workers(64) == 64
    assert options.parse_splits(None, "train=1000000,val=0001000000") == {"train": 10**6, "val": 10**6}
    assert sum(options.parse_splits(10**6, None).values()) == 10**6
    options.check_seed(2**63 - 1)


def test_an_empty_name_is_no_recipe():
    with pytest.raises(UsageError, match="Unknown recipe ''"):
        options.choose_recipe("", video=False)
