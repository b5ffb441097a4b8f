import dataclasses
import json

import numpy as np
import pytest

from datagen.scene import Body, Camera, Light, Material, Push, Scene, ShapeSpec, Table, scene_from_json, scene_to_json

RUBBER = Material("rubber", (0.8, 0.1, 0.1), color2=(0.1, 0.1, 0.8), pattern="stripes", axis=(0.0, 1.0, 0.0))
BOX = Body(
    category="box",
    shape=ShapeSpec("box", {"size": [0.1, 0.05, 0.02]}),
    material=RUBBER,
    density=500.0,
    friction=0.5,
    restitution=0.1,
    motion="push",
    position=(0.3, 0.0, 0.01),
    quaternion_wxyz=(1.0, 0.0, 0.0, 0.0),
    push=Push(0.1, 0.05, (1.0, 0.0, 0.0)),
)
SCENE = Scene(
    bodies=(BOX, dataclasses.replace(BOX, push=None, touches=0)),
    table=Table(2.0, Material("wood", (0.6, 0.4, 0.2))),
    cameras=(Camera((0.9, 0.0, 0.85), (0.28, 0.0, 0.0), 0.698132, 4 / 3),),
    lights=(Light((0.0, 0.0, 1.0), (1.0, 1.0, 0.9), 0.04), Light((1.0, 0.0, 0.0), (0.2, 0.2, 0.2), 0.0, False)),
    ambient=(0.3, 0.3, 0.3),
    backdrop=(0.5, 0.5, 0.5),
    frames=10,
    fps=12.0,
)


def test_a_scene_survives_the_way_through_text():
    assert scene_from_json(scene_to_json(SCENE)) == SCENE


def test_equal_scenes_have_equal_text_and_others_do_not():
    moved = dataclasses.replace(
        SCENE, bodies=(dataclasses.replace(BOX, position=(0.3, 0.0, 0.010001)), SCENE.bodies[1])
    )
    assert scene_to_json(scene_from_json(scene_to_json(SCENE))) == scene_to_json(SCENE)
    assert scene_to_json(moved) != scene_to_json(SCENE)


@pytest.mark.parametrize("text", ["", "{", "[]", "{}", '{"bodies": [{}]}'])
def test_other_text_is_not_a_scene(text):
    with pytest.raises((ValueError, KeyError, TypeError)):
        scene_from_json(text)


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("frames",), "ten"),
        (("fps",), float("nan")),
        (("fps",), float("inf")),
        (("fps",), 1e300),
        (("ambient",), [0.1, 0.2]),
        (("backdrop",), 0.5),
        (("table", "size"), None),
        (("table", "material", "pattern"), "tartan"),
        (("cameras", 0, "position"), [0.0, 0.0, True]),
        (("lights", 0, "direction"), "xyz"),
        (("bodies", 0, "motion"), "fly"),
        (("bodies", 0, "category"), 3),
        (("bodies", 0, "touches"), "first"),
        (("bodies", 0, "density"), []),
        (("bodies", 0, "push"), {"start": 0.0}),
        (("bodies", 0, "shape", "family"), ["box"]),
        (("bodies", 0, "shape", "parameters"), {"size": [1e9, 1.0, 1.0]}),
        (("bodies", 0, "shape", "parameters"), {"size": [0.1] * 10_000}),
        (("bodies", 0, "shape", "parameters"), {"size": {"x": 1.0}}),
        (("bodies", 0, "material", "color"), [0.0, 0.0, "red"]),
        (("bodies", 0, "mood"), "sad"),
    ],
)
def test_a_description_whose_values_are_none_is_not_a_scene(place: tuple[str | int, ...], value: object):
    data = json.loads(scene_to_json(SCENE))
    part = data
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    with pytest.raises((ValueError, KeyError, TypeError)):
        scene_from_json(json.dumps(data))


@pytest.mark.parametrize("aspect", [0.5, 1.0, 4 / 3])
@pytest.mark.parametrize(("width", "height"), [(128, 128), (320, 240), (192, 96), (96, 192), (500, 20)])
def test_every_image_shows_all_of_the_frame_and_no_more_than_it_must(aspect: float, width: int, height: int):
    camera = Camera((1.0, 0.0, 1.0), (0.0, 0.0, 0.0), np.radians(50), aspect)
    half_width = np.tan(np.radians(25))
    right, bottom, _ = camera.k(width, height) @ [half_width, half_width / aspect, 1.0]
    assert right <= width + 1e-9
    assert bottom <= height + 1e-9
    assert right == pytest.approx(width) or bottom == pytest.approx(height)
    left, top, _ = camera.k(width, height) @ [-half_width, -half_width / aspect, 1.0]
    assert (left + right, top + bottom) == pytest.approx((width, height))


def test_an_image_of_the_frames_aspect_is_as_wide_as_the_field_of_view():
    camera = Camera((1.0, 0.0, 1.0), (0.0, 0.0, 0.0), np.radians(90), 4 / 3)
    np.testing.assert_allclose(camera.k(320, 240), [[160, 0, 160], [0, 160, 120], [0, 0, 1]])
