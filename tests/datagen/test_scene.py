import dataclasses

import pytest

from datagen.scene import (
    Body,
    Camera,
    Light,
    Material,
    Push,
    Scene,
    ShapeSpec,
    Table,
    scene_from_json,
    scene_to_json,
)

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
    cameras=(Camera((0.9, 0.0, 0.85), (0.28, 0.0, 0.0), 0.698132),),
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
