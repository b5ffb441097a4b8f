import dataclasses
from collections import Counter

import numpy as np
import pytest

from datagen.config import Layout, MotionConfig, MotionWeights, Objects, Physics
from datagen.sampling.items import Item, sample_item
from datagen.sampling.layout import Spot, place
from datagen.sampling.motion import sample_motion, sample_starts
from datagen.scene import Motion

LAYOUT, MOTION, PHYSICS = Layout(), MotionConfig(), Physics()


def item(category: str) -> Item:
    return sample_item(Objects(categories=(category,), sizes=(0.08,)), "train", np.random.default_rng(0))


def spot(category: str, motion: Motion) -> Spot:
    return place(item(category), motion, [], LAYOUT, MOTION, np.random.default_rng(1))


def test_motions_come_as_often_as_the_weights_say():
    rng = np.random.default_rng(0)
    weights = MotionWeights(rest=1.0, drop=0.0, slide=3.0, roll=4.0, push=0.0, throw=0.0)
    motion = dataclasses.replace(MOTION, weights=weights)
    ball, box = item("sphere"), item("box")
    rolling = Counter(sample_motion(ball, motion, rng) for _ in range(2000))
    assert rolling["roll"] == pytest.approx(1000, abs=100)
    boxes = Counter(sample_motion(box, motion, rng) for _ in range(2000))
    assert set(boxes) == {"rest", "slide"}
    assert boxes["slide"] == pytest.approx(1500, abs=100)


def test_what_cannot_roll_slides_where_all_shall_roll():
    weights = MotionWeights(rest=0.0, drop=0.0, slide=0.0, roll=1.0, push=0.0, throw=0.0)
    motion = dataclasses.replace(MOTION, weights=weights)
    assert sample_motion(item("box"), motion, np.random.default_rng(0)) == "slide"


@pytest.mark.parametrize("category", ["sphere", "cylinder", "torus"])
def test_rolling_objects_do_not_slip_where_they_touch_the_table(category: str):
    rolling = spot(category, "roll")
    (start,) = sample_starts([rolling], LAYOUT, MOTION, PHYSICS, np.random.default_rng(2))
    below = np.array([0.0, 0.0, rolling.stance.bottom])
    at_contact = np.array(start.linear_velocity) + np.cross(start.angular_velocity, below)
    np.testing.assert_allclose(at_contact, 0, atol=1e-4)
    assert np.hypot(*start.linear_velocity[:2]) >= MOTION.speed[0] - 1e-5


def test_a_push_beats_friction():
    pushed = spot("box", "push")
    (start,) = sample_starts([pushed], LAYOUT, MOTION, PHYSICS, np.random.default_rng(0))
    assert start.push is not None
    weight = pushed.item.density * pushed.item.shape.volume * PHYSICS.gravity
    net = np.hypot(*start.push.force[:2]) - pushed.item.friction * PHYSICS.table_friction * weight
    speed = net / weight * PHYSICS.gravity * start.push.duration
    assert MOTION.speed[0] - 1e-3 <= speed <= MOTION.speed[1] + 1e-3


def test_what_is_aimed_goes_towards_another_object():
    aimed = dataclasses.replace(MOTION, aim_share=1.0)
    rng = np.random.default_rng(0)
    spots = [spot("box", "slide"), dataclasses.replace(spot("box", "rest"), position=np.array([0.2, 0.3, 0.04]))]
    for _ in range(5):
        start, still = sample_starts(spots, LAYOUT, aimed, PHYSICS, rng)
        way = (spots[1].position - spots[0].position)[:2]
        velocity = np.array(start.linear_velocity[:2])
        assert way @ velocity > 0.97 * np.hypot(*way) * np.hypot(*velocity)
        assert still.linear_velocity == (0.0, 0.0, 0.0)


def test_a_group_shares_its_velocity_or_its_acceleration():
    rng = np.random.default_rng(0)
    for kind in ("slide", "push"):
        group = [dataclasses.replace(spot(name, kind), in_group=True) for name in ("box", "gear")]
        friction = [dataclasses.replace(one, item=dataclasses.replace(one.item, friction=0.7)) for one in group]
        first, second = sample_starts(friction, LAYOUT, MOTION, PHYSICS, rng)
        assert first.linear_velocity == second.linear_velocity
        if kind == "push":
            masses = [one.item.density * one.item.shape.volume for one in group]
            forces = [np.hypot(*start.push.force[:2]) for start in (first, second)]
            assert forces[0] / masses[0] == pytest.approx(forces[1] / masses[1], rel=1e-3)


def test_nothing_moves_where_the_recipe_is_still():
    still = dataclasses.replace(MOTION, moving=False)
    (start,) = sample_starts([spot("box", "slide")], LAYOUT, still, PHYSICS, np.random.default_rng(0))
    assert start.linear_velocity == start.angular_velocity == (0.0, 0.0, 0.0)
    assert start.push is None
