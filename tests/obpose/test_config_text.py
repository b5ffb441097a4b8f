import functools
import re
from typing import Any

import pytest

from obpose.config import Config, override
from obpose.config_text import differences, from_plain, parse_changes, to_plain
from obpose.contact.config import ContactConfig, ContactObPoseConfig
from obpose.errors import UsageError
from obpose.variants import make_config


@pytest.mark.parametrize(
    ("lost", "message"),
    [
        ([], "lacks model.slots and 62 other values"),
        (["model"], "lacks model.slots and"),
        (["train"], "lacks train.batch and"),
        (["model", "pose"], "lacks model.pose.conditioning and"),
        (["model", "pose", "box_size"], "lacks model.pose.box_size: the file is damaged"),
        (["train", "seed"], "lacks train.seed: the file is damaged"),
    ],
)
def test_values_may_not_be_missing(lost: list[str], message: str):
    plain = to_plain(Config())
    if lost:
        del functools.reduce(dict.__getitem__, lost[:-1], plain)[lost[-1]]
    else:
        plain = {}
    with pytest.raises(UsageError, match=re.escape(message)):
        from_plain(plain)


def test_later_values_may_be_missing():
    plain = to_plain(ContactConfig())
    del plain["model"]["image_scale"], plain["train"]["rise"]
    assert from_plain(plain, ContactConfig) == override(ContactConfig(), {"train.rise": 0.0})


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("model.slots", True, "a whole number"),
        ("model.slots", 4.0, "a whole number"),
        ("model.slots", None, "a whole number"),
        ("model.spacing", "0.01", "a number"),
        ("model.spacing", True, "a number"),
        ("model.spacing", [0.01], "a number"),
        ("model.workspace_center", [0, 1], "2 values, expected 3"),
        ("model.workspace_center", [0, 1, "2"], "a number"),
        ("model.workspace_center", 3, "expected a list"),
        ("model.backbone.blocks", [8, 8.5], "a whole number"),
        ("model.backbone.blocks", {"0": 8}, "unknown values, model.backbone.blocks.0"),
        ("model.pose", 3, "unknown values, model.pose:"),
        ("model.pose", [], "unknown values, model.pose:"),
        ("loss.attention", ["l2"], "one of mixture, l2"),
        ("loss.attention", 10_000 * "l2\n", "one of mixture, l2"),
    ],
)
def test_values_of_another_kind_are_refused_in_one_short_line(name: str, value: object, expected: str):
    plain = to_plain(Config())
    *groups, last = name.split(".")
    functools.reduce(dict.__getitem__, groups, plain)[last] = value
    with pytest.raises(UsageError, match=re.escape(expected)) as caught:
        from_plain(plain)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_values_that_nobody_knows_are_refused():
    plain = to_plain(Config())
    plain["model"]["pose"]["colour"] = 3
    with pytest.raises(UsageError, match=r"unknown values, model\.pose\.colour: it was written by another version"):
        from_plain(plain)


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("model.pose.box_size=0.3", {"model.pose.box_size": 0.3}),
        ("loss.translation=2", {"loss.translation": 2.0}),
        ("train.learning_rate=1e-4", {"train.learning_rate": 1e-4}),
        ("train.batch=4", {"train.batch": 4}),
        ("train.steps=none", {"train.steps": None}),
        ("model.pose.conditioning=none", {"model.pose.conditioning": "none"}),
        ("model.backbone.blocks=16,32", {"model.backbone.blocks": (16, 32)}),
        ("model.backbone.blocks=[16, 32]", {"model.backbone.blocks": (16, 32)}),
        ("model.workspace_center=0,1,2.5", {"model.workspace_center": (0.0, 1.0, 2.5)}),
        ("model.table=null", {"model.table": None}),
        ("model.table=0", {"model.table": 0.0}),
    ],
)
def test_changes_are_read_as_what_the_value_is(text: str, change: dict[str, Any]):
    found = parse_changes([text])
    assert found == change
    assert [type(value) for value in found.values()] == [type(value) for value in change.values()]
    make_config(**found)


@pytest.mark.parametrize(("text", "value"), [("true", True), ("True", True), ("FALSE", False)])
def test_truth_is_written_as_in_json_or_python(text: str, value: bool):
    name = "model.clean_depth"
    assert parse_changes([f"{name}={text}"], ContactConfig) == {name: value}
    with pytest.raises(UsageError, match="expected true or false"):
        parse_changes([f"{name}=1"], ContactConfig)


def test_the_last_of_two_changes_counts():
    assert parse_changes(["train.batch=4", "train.batch=5"]) == {"train.batch": 5}


def test_unknown_values_name_all_files_that_list_values():
    with pytest.raises(UsageError, match=r"listed in obpose/contact/config\.py and obpose/config\.py\."):
        parse_changes(["nonsense=1"], ContactObPoseConfig)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("train.batch", "expected NAME=VALUE"),
        ("train.bach=4", "did you mean 'train.batch'"),
        ("model.pose=3", "unknown value 'model.pose'"),
        ("train.batch=2.5", "expected a whole number"),
        ("train.batch=true", "expected a whole number"),
        (f"train.batch={2**63}", "expected a number up to 9.22337e\\+18"),
        (f"loss.translation=1{400 * '0'}", "expected a number up to"),
        (f"loss.translation={5000 * '1'}", "expected a number"),
        ("loss.translation=thin", "expected a number"),
        ("loss.translation=NaN", "expected a number"),
        ("loss.translation=Infinity", "expected a number"),
        ("loss.translation=1e999", "expected a number"),
        ("model.workspace_center=[NaN,0,0]", "expected a list"),
        ("model.pose.conditioning=near", "expected one of world, none, location, full"),
        ("train.steps=some", "expected a whole number or none"),
        ("model.workspace_center=1,2", "2 values, expected 3"),
        ("model.backbone.blocks=a,b", "expected a list"),
    ],
)
def test_impossible_changes_are_refused(text: str, message: str):
    with pytest.raises(UsageError, match=message):
        parse_changes([text])


def test_differences_are_named():
    one, other = make_config(), make_config("obpose-loc", **{"train.batch": 4})
    assert differences(one, one) == []
    assert differences(one, other) == ["model.pose.conditioning: full, location", "train.batch: 1, 4"]
