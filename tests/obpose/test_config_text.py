from typing import Any

import pytest

from obpose.config import Config
from obpose.config_text import differences, from_plain, parse_changes, to_plain
from obpose.errors import UsageError
from obpose.variants import PROFILES, VARIANTS, make_config


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("profile", PROFILES)
def test_every_configuration_survives_as_text(variant: str, profile: str):
    config = make_config(variant, profile)
    assert from_plain(to_plain(config)) == config


def test_values_that_an_older_file_lacks_have_their_defaults():
    plain = to_plain(make_config(**{"train.batch": 9}))
    del plain["model"]["pose"]
    assert from_plain(plain) == make_config(**{"train.batch": 9})


def test_values_that_nobody_knows_are_refused():
    plain = to_plain(Config())
    plain["model"]["pose"]["colour"] = 3
    with pytest.raises(UsageError, match=r"unknown values, model\.pose\.colour: it was written by another version"):
        from_plain(plain)


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("model.pose.box_size=0.3", {"model.pose.box_size": 0.3}),
        ("loss.air=2", {"loss.air": 2.0}),
        ("train.learning_rate=1e-4", {"train.learning_rate": 1e-4}),
        ("train.batch=4", {"train.batch": 4}),
        ("train.steps=none", {"train.steps": None}),
        ("model.pose.conditioning=none", {"model.pose.conditioning": "none"}),
        ("model.backbone.widths=16,32", {"model.backbone.widths": (16, 32)}),
        ("model.backbone.widths=[16, 32]", {"model.backbone.widths": (16, 32)}),
        ("model.workspace_center=0,1,2.5", {"model.workspace_center": (0.0, 1.0, 2.5)}),
        ("model.floor=null", {"model.floor": None}),
        ("model.floor=0", {"model.floor": 0.0}),
    ],
)
def test_changes_are_read_as_what_the_value_is(text: str, change: dict[str, Any]):
    found = parse_changes([text])
    assert found == change
    assert [type(value) for value in found.values()] == [type(value) for value in change.values()]
    make_config(**found)


def test_the_last_of_two_changes_counts():
    assert parse_changes(["train.batch=4", "train.batch=5"]) == {"train.batch": 5}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("train.batch", "expected NAME=VALUE"),
        ("train.bach=4", "did you mean 'train.batch'"),
        ("model.pose=3", "unknown value 'model.pose'"),
        ("train.batch=2.5", "expected a whole number"),
        ("train.batch=true", "expected a whole number"),
        (f"train.batch={2**63}", "a whole number of 64 bits; expected one of at most 63"),
        (f"loss.air=1{400 * '0'}", "a whole number of 1329 bits"),
        (f"loss.air={5000 * '1'}", "expected a number"),
        ("loss.air=thin", "expected a number"),
        ("model.pose.conditioning=near", "expected one of world, none, location, full"),
        ("train.steps=some", "expected a whole number or none"),
        ("model.workspace_center=1,2", "2 values, expected 3"),
        ("model.backbone.widths=a,b", "expected"),
    ],
)
def test_impossible_changes_are_refused(text: str, message: str):
    with pytest.raises(UsageError, match=message):
        parse_changes([text])


def test_differences_are_named():
    one, other = make_config(), make_config("obpose-loc", **{"train.batch": 4})
    assert differences(one, one) == []
    assert differences(one, other) == ["model.pose.conditioning: full, location", "train.batch: 1, 4"]
