import re

import pytest

from obpose.config_bounds import check_bounds
from obpose.config_text import parse_changes
from obpose.errors import UsageError
from obpose.variants import PROFILES, VARIANTS, make_config


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("profile", PROFILES)
def test_our_own_configurations_are_within_bounds(variant: str, profile: str):
    check_bounds(make_config(variant, profile, **{"train.steps": 1}))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("model.slots=0", "model.slots is 0; expected 1 or more"),
        ("train.batch=-1", "train.batch is -1; expected 1 or more"),
        ("train.batch=100000000", "train.batch is 100000000; expected at most 1000000"),
        ("model.slots=255", "model.slots is 255; expected at most 254"),
        ("model.pose.grid_level=5", "model.pose.grid_level is 5; expected at most 4"),
        ("model.latent.frequencies=25", "model.latent.frequencies is 25; expected at most 24"),
        ("model.voxels=65537", "model.voxels is 65537; expected at most 65536"),
        ("train.steps=-3", "train.steps is -3; expected 1 or more"),
        ("train.rays=-5", "train.rays is -5; expected 0 or more, and finite"),
        ("train.seed=-1", "train.seed is -1; expected 0 or more, and less than 2^63"),
        ("train.minutes=Infinity", "train.minutes is inf; expected more than 0, and finite"),
        ("train.learning_rate=NaN", "train.learning_rate is nan; expected a number"),
        ("train.object_rays=1", "train.object_rays is 1.0; expected 0 or more, and less than 1"),
        ("model.pose.box_size=0", "model.pose.box_size is 0.0; expected more than 0, and finite"),
        ("loss.colour_std=0", "loss.colour_std is 0.0; expected more than 0, and finite"),
        ("model.backbone.colour=5", "model.backbone.colour is 5; expected 6 or more"),
        ("model.attention.idle_scope=0.0", "model.attention.idle_scope is 0.0; expected between 0 and 1"),
        ("model.attention.looks=-1", "model.attention.looks is -1; expected 0 or more, and finite"),
        ("model.attention.mask_power=0", "model.attention.mask_power is 0.0; expected more than 0, and finite"),
        ("model.latent.posterior_std=0", "model.latent.posterior_std is 0.0; expected more than 0, and finite"),
        ("loss.air_saturation=0", "loss.air_saturation is 0.0; expected more than 0, and finite"),
        ("model.slot_attention.iterations=0", "model.slot_attention.iterations is 0; expected 1 or more"),
        ("model.background=none", "model.pose.conditioning is full; expected world"),
        ("model.attention.kind=slots", "model.pose.conditioning is full; expected none or world"),
        ("model.attention.evaluation_rounds=-1", "model.attention.evaluation_rounds is -1; expected 0 or more"),
        ("model.backbone.widths=[]", "model.backbone.widths is (); expected numbers of 4 or more"),
        ("model.backbone.widths=[3,8,8,8]", "model.backbone.widths is (3, 8, 8, 8); expected numbers of 4 or more"),
        ("model.backbone.blocks=1", "model.backbone.blocks is (1,); expected 4 numbers"),
        ("model.workspace_center=[NaN,0,0]", "model.workspace_center is (nan, 0.0, 0.0); expected finite numbers"),
        ("model.workspace_center=[0,Infinity,0]", "model.workspace_center is (0.0, inf, 0.0); expected finite numbers"),
        ("model.backbone.output_level=4", "model.backbone.output_level is 4; expected 0 to 3"),
    ],
)
def test_values_of_which_nothing_can_be_made_are_named(change: str, message: str):
    with pytest.raises(UsageError, match=re.escape(message)):
        check_bounds(make_config(**parse_changes([change])))


@pytest.mark.parametrize(
    ("variant", "change", "message"),
    [
        ("ic-sbp", "model.table=0.004", "model.table is 0.004; expected none"),
        ("ic-sbp", "train.warmup=5", "train.warmup is 5; expected 0, as there is no background to warm up"),
        (
            "slot-attention",
            "model.attention.evaluation_rounds=1",
            "model.attention.evaluation_rounds is 1; expected 0, as slot attention",
        ),
    ],
)
def test_values_that_need_a_part_that_is_not_there_are_named(variant: str, change: str, message: str):
    with pytest.raises(UsageError, match=re.escape(message)):
        check_bounds(make_config(variant, **parse_changes([change])))
