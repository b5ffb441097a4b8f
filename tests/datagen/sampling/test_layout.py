import dataclasses

import numpy as np
import pytest

from datagen.config import Layout, MotionConfig, load_recipe
from datagen.sampling import layout as layouts
from datagen.sampling.items import Item, Rejected, sample_item

OBJECTS = load_recipe("moving").objects
LAYOUT = Layout()
MOTION = MotionConfig()


def items(count: int, seed: int = 0, categories: tuple[str, ...] = (), sizes: tuple[float, ...] = ()) -> list[Item]:
    rng = np.random.default_rng(seed)
    objects = dataclasses.replace(OBJECTS, categories=categories, sizes=sizes)
    return [sample_item(objects, "train", rng) for _ in range(count)]


@pytest.mark.parametrize("seed", range(5))
def test_scattered_objects_stand_apart_on_the_table(seed: int):
    rng = np.random.default_rng(seed)
    spots = layouts.scatter(items(4, seed), ["rest"] * 4, LAYOUT, MOTION, rng)
    for row, spot in enumerate(spots):
        assert 0 < spot.low < 1e-3
        assert np.all(np.abs(spot.position[:2] - LAYOUT.center) <= LAYOUT.half_extent)
        for other in spots[:row]:
            points, others = (s.stance.points[:, :2] + s.position[:2] for s in (spot, other))
            distances = np.sqrt(np.sum((points[:, None] - others[None]) ** 2, axis=-1))
            assert np.min(distances) >= LAYOUT.gap


def test_what_drops_hangs_over_the_rest_and_never_in_it():
    small = dataclasses.replace(LAYOUT, half_extent=(0.02, 0.02))
    spots = layouts.scatter(items(3), ["drop", "rest", "throw"], small, MOTION, np.random.default_rng(0))
    ground, *air = sorted(spots, key=lambda spot: spot.low)
    assert ground.motion == "rest"
    assert air[0].low >= ground.high + MOTION.drop_height[0] - 1e-9
    assert air[1].low >= air[0].high + MOTION.drop_height[0] - 1e-9


def test_what_fits_in_hangs_over_its_container():
    container, *others = items(1, 0, ("crate",), (0.2,)) + items(8, 1, sizes=(0.04, 0.16))
    small = [item for item in others if layouts.fits(item, container)]
    assert 0 < len(small) < len(others)
    crate, *inside = layouts.fill(container, small, LAYOUT, MOTION, np.random.default_rng(0))
    assert np.allclose(crate.stance.rotation[2], [0, 0, 1])
    below = crate
    for spot in inside:
        assert spot.low > below.high
        assert np.all(np.abs(spot.position[:2] - crate.position[:2]) < np.min(container.shape.size[:2]) / 4)
        below = spot


@pytest.mark.parametrize(("kinds", "fitting"), [(["rest"] * 3, 1), (["rest", "drop", "rest", "throw"], 3)])
def test_a_full_table_says_how_many_objects_had_a_place(kinds: list, fitting: int):
    small = dataclasses.replace(LAYOUT, half_extent=(0.02, 0.02))
    with pytest.raises(Rejected, match="crowded") as rejected:
        layouts.scatter(items(len(kinds)), kinds, small, MOTION, np.random.default_rng(0))
    assert rejected.value.fitting == fitting


@pytest.mark.parametrize("seed", range(5))
def test_a_group_has_every_object_touch_an_earlier_one_or_lie_on_it(seed: int):
    half = dataclasses.replace(LAYOUT, stack_share=0.5)
    group = layouts.cluster(
        items(4, seed, ("box", "cylinder", "gear", "prism")), "slide", half, np.random.default_rng(seed)
    )
    assert all(spot.in_group for spot in group)
    for row, spot in enumerate(group[1:], 1):
        if spot.touches is None:
            assert any(abs(spot.low - other.high) < 1e-3 for other in group[:row])
        else:
            assert spot.touches < row
            assert spot.low < 1e-3


def test_only_a_flat_roof_carries():
    rng = np.random.default_rng(0)
    brick, ball, cone = (items(1, 0, (name,))[0] for name in ("cube", "sphere", "cone"))
    ground = layouts.place(brick, "rest", [], LAYOUT, MOTION, rng)
    flat = layouts.flattest(brick)
    assert flat is not None
    upper = layouts.on_top(brick, "rest", flat, [ground], rng)
    assert upper is not None
    assert 0 < upper.low - ground.high < 1e-3
    assert layouts.on_top(brick, "rest", flat, [ground, upper], rng).low > upper.high
    for pointed in (ball, cone):
        spot = layouts.place(pointed, "rest", [], dataclasses.replace(LAYOUT, upright_share=1.0), MOTION, rng)
        assert layouts.on_top(brick, "rest", flat, [spot], rng) is None
    assert layouts.flattest(ball) is None
