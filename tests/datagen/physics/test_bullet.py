import dataclasses
import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from datagen.config import Physics
from datagen.geometry import rotation_from_quaternion
from datagen.physics.bullet import World
from datagen.scene import Body, Material, Push, Scene, ShapeSpec, Table, Trajectory
from datagen.shapes import build
from tests.paths import ROOT

pytestmark = pytest.mark.skipif(not importlib.util.find_spec("pybullet"), reason="simulation needs PyBullet")

PAINT = Material("paint", (0.5, 0.5, 0.5))
BOX = ShapeSpec("box", {"size": [0.1, 0.08, 0.04]})
PHYSICS = Physics()


def body(at: tuple[float, ...], spec: ShapeSpec = BOX, **changes) -> Body:
    fixed = {"category": spec.family, "shape": spec, "material": PAINT, "density": 500.0, "motion": "rest"}
    values = {
        "friction": 0.6,
        "restitution": 0.0,
        "quaternion_wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": tuple(map(float, at)),
    }
    return Body(**{**fixed, **values, **changes})


def run(*bodies: Body, frames: int = 10, physics: Physics = PHYSICS) -> Trajectory:
    scene = Scene(bodies, Table(2.0, PAINT), (), (), (0.3, 0.3, 0.3), (0.5, 0.5, 0.5), frames, 12.0)
    with World(scene, [build(one.shape) for one in bodies], physics) as world:
        world.start()
        return world.run()


def parameters(category: str, seed: int = 0) -> ShapeSpec:
    from datagen.catalog import sample_shape

    return sample_shape(category, np.random.default_rng(seed), (0.1, 0.1))


def test_free_fall_follows_the_parabola():
    trajectory = run(body((0, 0, 1.0), linear_velocity=(0.3, 0.0, 0.5)), frames=5)
    time = np.arange(5) / 12
    np.testing.assert_allclose(trajectory.position[:, 0, 0], 0.3 * time, atol=1e-6)
    # Bullet moves with the speed at the end of each step: half a step's worth of gravity more.
    height = 1.0 + 0.5 * time - 9.81 / 2 * time * (time + PHYSICS.step)
    np.testing.assert_allclose(trajectory.position[:, 0, 2], height, atol=1e-6)
    np.testing.assert_allclose(trajectory.linear_velocity[:, 0, 2], 0.5 - 9.81 * time, atol=1e-5)


@pytest.mark.parametrize("category", ["box", "cylinder", "mug", "bracket", "gear"])
def test_what_stands_on_the_table_stays(category: str):
    spec = parameters(category)
    trajectory = run(body((0.1, -0.2, -float(np.min(build(spec).vertices[:, 2]))), spec))
    np.testing.assert_allclose(trajectory.position, trajectory.position[:1].repeat(10, 0), atol=3e-4)
    np.testing.assert_allclose(trajectory.contact_gap[:, 0, 1], 0, atol=5e-4)


@pytest.mark.parametrize("angle", [0.0, 0.7])
@pytest.mark.parametrize("speed", [0.4, 0.8])
def test_a_box_slides_as_far_as_coulomb_says(speed: float, angle: float):
    velocity = (speed * np.cos(angle), speed * np.sin(angle), 0.0)
    trajectory = run(body((0, 0, 0.02), linear_velocity=velocity))
    way = np.sqrt(np.sum((trajectory.position[-1, 0] - trajectory.position[0, 0]) ** 2))
    friction = 0.6 * PHYSICS.table_friction
    assert way == pytest.approx(speed**2 / (2 * friction * 9.81), rel=0.03)


def test_a_ball_rolls_without_slipping_and_slows_down_as_told():
    ball = ShapeSpec("sphere", {"radius": 0.05})
    trajectory = run(body((0, 0, 0.05), ball, linear_velocity=(0.5, 0.0, 0.0), angular_velocity=(0.0, 10.0, 0.0)))
    # The torque acts on 7/5 m r^2, the moment of inertia of a ball about its point of contact.
    lever = PHYSICS.rolling_friction * (0.6 + PHYSICS.table_friction)
    slowing = 5 / 7 * 9.81 * lever / 0.05
    assert trajectory.position[-1, 0, 0] == pytest.approx(0.5 * 0.75 - slowing * 0.75**2 / 2, rel=0.005)
    np.testing.assert_allclose(
        trajectory.angular_velocity[:, 0, 1] * 0.05, trajectory.linear_velocity[:, 0, 0], atol=5e-3
    )


@pytest.mark.parametrize("category", ["bracket", "hammer", "box"])
def test_free_rotation_keeps_angular_momentum_and_energy(category: str):
    spec = parameters(category)
    inertia = 500 * build(spec).inertia
    weightless = dataclasses.replace(PHYSICS, gravity=0.0)
    spinning = body((0, 0, 0.5), spec, angular_velocity=(0.4, 6.0, 0.8), quaternion_wxyz=(0.8, 0.0, 0.6, 0.0))
    trajectory = run(spinning, frames=12, physics=weightless)
    rotation = rotation_from_quaternion(trajectory.quaternion_wxyz[:, 0])
    spin = trajectory.angular_velocity[:, 0].astype(float)
    momentum = (rotation @ inertia @ np.swapaxes(rotation, -1, -2) @ spin[..., None])[..., 0]
    size = np.sqrt(np.sum(momentum[0] ** 2))
    np.testing.assert_allclose(momentum, momentum[:1].repeat(12, 0), atol=0.01 * size)
    energy = np.sum(spin * momentum, axis=-1)
    np.testing.assert_allclose(energy, energy[0], rtol=0.01)
    assert np.ptp(rotation[:, 0, 0]) > 0.5


def test_the_pose_is_that_of_the_object_frame_whatever_the_principal_axes():
    spec = parameters("bracket")
    turned = body((0.1, 0.2, 0.5), spec, quaternion_wxyz=(0.5, 0.5, -0.5, 0.5))
    start = run(turned, frames=1)
    np.testing.assert_allclose(start.quaternion_wxyz[0, 0], turned.quaternion_wxyz, atol=1e-6)
    np.testing.assert_allclose(start.position[0, 0], turned.position, atol=1e-6)


@pytest.mark.parametrize(("gap", "found"), [(0.003, 0.003), (-0.004, -0.004), (0.019, 0.019), (0.021, np.inf)])
def test_the_gap_of_two_boxes_is_the_distance_of_their_faces(gap: float, found: float):
    start = run(body((0, 0, 0.5)), body((0.1 + gap, 0.01, 0.5)), frames=1)
    assert start.contact_gap[0, 1, 2] == start.contact_gap[0, 2, 1]
    assert start.contact_gap[0, 1, 2] == pytest.approx(found, abs=2e-4)
    assert np.all(np.isinf(start.contact_gap[0, 0]))


@pytest.mark.parametrize("category", ["table", "bracket", "prism", "mug", "superquadric", "cone", "hammer"])
def test_the_gap_to_the_table_is_that_of_the_true_surface(category: str):
    spec = parameters(category, seed=3)
    lowest = -float(np.min(build(spec).vertices[:, 2]))
    start = run(body((0, 0, lowest + 0.005), spec), frames=1)
    assert start.contact_gap[0, 0, 1] == pytest.approx(0.005, abs=1e-3)


def test_a_resting_box_presses_on_the_table_with_its_weight():
    trajectory = run(body((0, 0, 0.02)))
    weight = 500 * 0.1 * 0.08 * 0.04 * 9.81
    np.testing.assert_array_equal(trajectory.contact_impulse[0], 0)
    np.testing.assert_allclose(trajectory.contact_impulse[2:, 0, 1], weight / 12, rtol=0.01)


def test_the_lightest_touch_is_recorded():
    trajectory = run(body((0, 0, 0.02), density=0.01))
    weight = 0.01 * 0.1 * 0.08 * 0.04 * 9.81
    np.testing.assert_allclose(trajectory.contact_impulse[2:, 0, 1], weight / 12, rtol=0.02)


def test_a_collision_exchanges_momentum_and_is_recorded():
    weightless = dataclasses.replace(PHYSICS, gravity=0.0)
    trajectory = run(
        body((0, 0, 0.5), linear_velocity=(0.6, 0.0, 0.0)), body((0.15, 0, 0.5)), frames=6, physics=weightless
    )
    mass = 500 * 0.1 * 0.08 * 0.04
    np.testing.assert_allclose(np.sum(trajectory.linear_velocity[:, :, 0], axis=1), 0.6, rtol=1e-3)
    received = mass * trajectory.linear_velocity[-1, 1, 0]
    assert received > 0.1 * mass
    assert np.sum(trajectory.contact_impulse[:, 1, 2]) == pytest.approx(received, rel=0.02)


def test_a_push_gives_its_momentum():
    weightless = dataclasses.replace(PHYSICS, gravity=0.0)
    pushed = body((0, 0, 0.5), push=Push(0.1, 0.25, (0.2, 0.0, 0.0)))
    trajectory = run(pushed, physics=weightless)
    np.testing.assert_allclose(trajectory.linear_velocity[:2, 0], 0, atol=1e-9)
    mass = 500 * 0.1 * 0.08 * 0.04
    assert mass * trajectory.linear_velocity[-1, 0, 0] == pytest.approx(0.2 * 0.25, rel=0.02)


@pytest.mark.parametrize("category", ["box", "gear", "mug", "bracket"])
def test_what_shall_touch_touches_before_time_starts(category: str):
    spec = parameters(category)
    lowest = -float(np.min(build(spec).vertices[:, 2]))
    start = run(body((0, 0, 0.021)), body((0.2, 0.05, lowest + 0.001), spec, touches=0), frames=1)
    assert -1e-5 < start.contact_gap[0, 1, 2] < 1e-3


def test_settling_lets_what_falls_come_to_rest_before_the_first_frame():
    settled = dataclasses.replace(PHYSICS, settle_seconds=1.0)
    start = run(body((0, 0, 0.1)), frames=1, physics=settled)
    assert start.position[0, 0, 2] == pytest.approx(0.02, abs=3e-4)
    assert np.max(np.abs(start.linear_velocity)) < 1e-3


SCENES = [
    (body((0, 0, 0.3), parameters("mug"), angular_velocity=(3.0, 1.0, 2.0)), body((0.02, 0, 0.02))),
    (body((0, 0, 0.3), parameters("bracket")), body((0.01, 0.02, 0.02), linear_velocity=(0.5, 0.1, 0.0))),
    (body((0, 0, 0.05), ShapeSpec("sphere", {"radius": 0.05}), linear_velocity=(1.0, 0.0, 0.0)), body((0.2, 0, 0.02))),
]


def fingerprint(trajectory: Trajectory) -> str:
    return "".join(array.tobytes().hex() for array in vars(trajectory).values())


def test_a_scene_does_not_depend_on_what_was_simulated_before():
    forward = [fingerprint(run(*bodies)) for bodies in SCENES]
    backward = [fingerprint(run(*bodies)) for bodies in reversed(SCENES)]
    assert forward == backward[::-1]
    assert len(set(forward)) == len(SCENES)


def test_without_pybullet_the_message_says_what_still_works():
    code = (
        "import sys; sys.modules['pybullet'] = None\n"
        "import datagen.pipeline.simulate\n"
        "from datagen import config, errors\n"
        "try: datagen.pipeline.simulate.simulate_scene(config.load_recipe('moving'), 0, 'train', 0)\n"
        "except errors.UsageError as error: print(error)\n"
    )
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "Python 3.11" in shown
    assert "obpose-datagen render --from DIR" in shown
    assert "pip install 'obpose[simulate]'" in shown


@pytest.mark.slow
def test_memory_stays_flat_over_many_scenes():
    bodies = [body((0.2 * row, 0, 0.3), parameters(name)) for row, name in enumerate(("mug", "superquadric", "box"))]
    after = []
    for _ in range(2):
        for _ in range(300):
            run(*bodies, frames=1)
        after.append(int(Path("/proc/self/statm").read_text().split()[1]) * 4096)
    assert after[1] - after[0] < 1e6
