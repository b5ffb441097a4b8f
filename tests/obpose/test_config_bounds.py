import math
import re

import pytest

from obpose.config_bounds import check_bounds
from obpose.config_text import parse_changes
from obpose.errors import UsageError
from obpose.variants import make_config


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("model.slots=0", "model.slots is 0; expected 1 or more"),
        ("train.batch=-1", "train.batch is -1; expected 1 or more"),
        ("train.batch=100000000", "train.batch is 100000000; expected at most 4096"),
        ("train.frames=1000000", "train.frames is 1000000; expected at most 4096"),
        ("train.batch=820", "train.batch is 820; expected a number that gives at most 4096 images a step"),
        ("model.slots=255", "model.slots is 255; expected at most 254"),
        ("model.latent.frequencies=25", "model.latent.frequencies is 25; expected at most 24"),
        ("model.voxels=129", "model.voxels is 129; expected at most 128"),
        ("model.object_field.width=1025", "model.object_field.width is 1025; expected at most 1024"),
        ("model.background_field.depth=17", "model.background_field.depth is 17; expected at most 16"),
        ("model.backbone.blocks=0,1,1,17", "model.backbone.blocks is (0, 1, 1, 17); expected 4 numbers of 0 to 16"),
        ("model.attention.mean_shift_steps=101", "model.attention.mean_shift_steps is 101; expected at most 100"),
        ("model.latent.samples=1000001", "model.latent.samples is 1000001; expected at most 1000000"),
        ("train.steps=1000000001", "train.steps is 1000000001; expected at most 1000000000"),
        ("train.minutes=1e7", "train.minutes is 10000000.0; expected at most 5256000"),
        ("model.spacing=1e10", "model.spacing is 10000000000.0; expected finite numbers between -1e+09 and 1e+09"),
        ("train.steps=-3", "train.steps is -3; expected 1 or more"),
        ("train.rays=-5", "train.rays is -5; expected 0 or more, and finite"),
        ("train.seed=-1", "train.seed is -1; expected 0 or more, and less than 2^63"),
        ("train.object_rays=1", "train.object_rays is 1.0; expected 0 or more, and less than 1"),
        ("model.pose.box_size=0", "model.pose.box_size is 0.0; expected more than 0, and finite"),
        (
            "model.attention.mean_shift_steps=-1",
            "model.attention.mean_shift_steps is -1; expected 0 or more, and finite",
        ),
        ("model.attention.mask_exponent=0", "model.attention.mask_exponent is 0.0; expected more than 0, and finite"),
        ("model.latent.posterior_std=0", "model.latent.posterior_std is 0.0; expected more than 0, and finite"),
        ("loss.air_saturation=0", "loss.air_saturation is 0.0; expected more than 0, and finite"),
        ("model.background=none", "model.pose.conditioning is full; expected world"),
        ("model.attention.kind=slots", "model.pose.conditioning is full; expected none or world"),
        ("model.attention.posterior_refinements=-1", "model.attention.posterior_refinements is -1; expected 0 or more"),
        ("model.backbone.blocks=1", "model.backbone.blocks is (1,); expected 4 numbers"),
        ("model.backbone.output_level=4", "model.backbone.output_level is 4; expected 0 to 3"),
    ],
)
def test_values_of_which_nothing_can_be_made_are_named(change: str, message: str):
    with pytest.raises(UsageError, match=re.escape(message)):
        check_bounds(make_config(**parse_changes([change])))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("train.minutes", math.inf),
        ("train.learning_rate", math.nan),
        ("model.table", math.nan),
        ("model.table", -math.inf),
        ("model.workspace_center", (math.nan, 0.0, 0.0)),
        ("model.workspace_center", (0.0, math.inf, 0.0)),
    ],
)
def test_numbers_are_finite(name: str, value: object):
    with pytest.raises(UsageError, match=rf"{name} is .*; expected finite numbers"):
        check_bounds(make_config(**{name: value}))


@pytest.mark.parametrize(
    ("variant", "change", "message"),
    [
        ("ic-sbp", "model.table=0.004", "model.table is 0.004; expected none"),
        ("ic-sbp", "train.warmup=5", "train.warmup is 5; expected 0, as there is no background to warm up"),
        (
            "slot-attention",
            "model.attention.posterior_refinements=1",
            "model.attention.posterior_refinements is 1; expected 0, as slot attention",
        ),
    ],
)
def test_values_that_need_a_part_that_is_not_there_are_named(variant: str, change: str, message: str):
    with pytest.raises(UsageError, match=re.escape(message)):
        check_bounds(make_config(variant, **parse_changes([change])))
