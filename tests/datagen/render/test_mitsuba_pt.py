"""The path tracer against the rasteriser."""

import dataclasses
import subprocess
import sys
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from datagen.config import recipe_to_dict
from datagen.errors import UsageError
from datagen.pipeline.make_scene import make_scene, renderer_identity
from datagen.render import make_renderer
from datagen.render.mitsuba_pt import MitsubaRenderer
from datagen.render.raster import RasterRenderer
from datagen.render.renderer import PathTracer
from datagen.scene import Camera, Lens, Material, Table
from datagen.storage.spec import groups_of, make_spec
from datagen.verify import verify_record
from tests.worlds.generated import recipe
from tests.worlds.handmade import FRONT, poses, render, six_objects

pytest.importorskip("mitsuba", reason="the mitsuba renderer needs the extra mitsuba")

OFF_CENTER = Camera((0.87, 0.1, 0.84), (0.28, 0.0, 0.0), 0.7, lens=Lens(64, 48, 80.0, 80.0, 38.0, 20.0))


@pytest.fixture(scope="module")
def tracer() -> PathTracer:
    tracer = make_renderer("mitsuba", samples=36)
    assert isinstance(tracer, PathTracer)
    return tracer


@pytest.mark.parametrize("camera", [FRONT, OFF_CENTER])
def test_the_path_tracer_shows_what_the_rasteriser_shows(tracer, camera):
    striped = Material("table", (0.6, 0.5, 0.4), (0.2, 0.3, 0.4), "two-tone", axis=(0.8, 0.6, 0.0))
    made = dataclasses.replace(six_objects(), table=Table(1.2, striped))
    labels, plain = render(tracer, made, camera, 64, 48), render(RasterRenderer(), made, camera, 64, 48)
    for name in ("rgb", "depth", "segmentation", "amodal_pixels"):
        np.testing.assert_array_equal(getattr(labels, name), getattr(plain, name))
    traced = tracer.photograph(poses(made), camera, 64, 48)
    difference = np.abs(traced.astype(int) - plain.rgb)
    assert np.median(difference) <= 16
    assert np.mean(difference) <= 20
    shifted = np.abs(np.roll(traced, 3, axis=1).astype(int) - plain.rgb)[:, 4:-4]
    assert np.mean(shifted) > 1.3 * np.mean(difference[:, 4:-4])


def test_equal_arguments_give_equal_noise_and_other_poses_give_other_noise(tracer):
    made, moved = six_objects(), poses(six_objects())
    render(tracer, made, FRONT, 32, 32)
    first, again = (tracer.photograph(poses(made), FRONT, 32, 32) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    moved[0, 2, 3] += 1e-6
    assert np.mean(tracer.photograph(moved, FRONT, 32, 32) != first) > 0.2


@pytest.mark.parametrize(("samples", "shares"), [(3, [1, 1, 1]), (64, [16] * 4), (6, [1, 1, 2, 2])])
def test_a_single_bright_pass_is_noise_and_a_bright_place_is_not(samples, shares):
    used = []

    def render(_world, *, spp, seed):
        used.append(spp)
        rare = 500.0 if len(used) == 2 else 0.1
        return np.array([[[rare, 0.05, 0.05, 1.0], [30.0, 30.0, 30.0, 1.0]]])

    found = MitsubaRenderer._trace(
        cast(Any, SimpleNamespace(samples=samples, _mi=SimpleNamespace(render=render))), 0, 0
    )
    assert used == shares
    np.testing.assert_allclose(found[0, 1], [30, 30, 30, 1])
    assert 0.1 <= found[0, 0, 0] < 0.2


def test_pixels_that_are_not_square_are_refused(tracer):
    render(tracer, six_objects(), OFF_CENTER)
    with pytest.raises(UsageError, match="needs square pixels"):
        tracer.photograph(poses(six_objects()), OFF_CENTER, 64, 64)


def test_a_dataset_differs_in_its_colours_alone():
    records = []
    for renderer, samples in (("raster", None), ("mitsuba", 4)):
        sensed = dataclasses.replace(recipe(), sensor=dataclasses.replace(recipe().sensor, enabled=True))
        identity = renderer_identity(renderer, samples)
        size = {"splits": {"test": 1}, "resolution": (24, 24)}
        spec = make_spec(recipe_to_dict(sensed), seed=0, renderer=identity, edits=["remove"], **size)
        records.append(make_scene(spec, "test", 0))
    plain, traced = records
    assert verify_record(traced, groups_of(spec), sensor=sensed.sensor, renderer="mitsuba") == []
    differing = {name for name in plain if not np.array_equal(plain[name], traced[name])}
    assert differing == {"rgb", "edits/remove/rgb"}


def test_engine_and_samples_belong_to_the_identity():
    identity = renderer_identity("mitsuba", 4)
    assert identity is not None
    assert (identity["name"], identity["samples"]) == ("mitsuba", 4)
    assert str(identity["engine"]).split()[1] in ("llvm", "scalar")
    with pytest.raises(UsageError, match="--samples is for --renderer mitsuba"):
        renderer_identity("rich", 4)
    with pytest.raises(UsageError, match="--samples is 0; expected 1 to 65,536"):
        renderer_identity("mitsuba", 0)


def test_without_mitsuba_the_message_says_what_to_install():
    code = (
        "import sys; sys.modules['mitsuba'] = None\n"
        "from datagen.render import make_renderer\n"
        "from datagen.errors import UsageError\n"
        "try: make_renderer('mitsuba')\n"
        "except UsageError as error: print(error)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "pip install 'obpose[mitsuba]'" in found.stdout
