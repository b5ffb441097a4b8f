import numpy as np

from benchmark.studies.drawing import Cubes, Eye, Segment, draw, look_at

SIZE = 40
RED, BLUE = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def cube(place: tuple[float, float, float], colour: tuple[float, float, float], opacity: float = 1.0) -> Cubes:
    return Cubes(np.array([place], float), np.eye(3), 0.1, np.array([colour]), np.array([opacity]))


def eye() -> Eye:
    return look_at(np.zeros(3), (1.0, 0.0, 0.2), distance=1.0, focal=2.0)


def middle(*cubes: Cubes) -> np.ndarray:
    return np.asarray(draw(cubes, eye(), size=SIZE))[SIZE // 2, SIZE // 2]


def test_what_is_looked_at_is_in_the_middle_and_up_is_up():
    seen = eye()
    assert np.allclose(seen.project(np.zeros(3), SIZE), SIZE / 2)
    assert seen.project(np.array([0, 0, 0.1]), SIZE)[1] < SIZE / 2
    assert seen.project(np.array([0, 0.1, 0]), SIZE)[0] > SIZE / 2
    assert np.isclose(np.linalg.det(seen.rotation), 1)


def test_the_nearer_cube_hides_the_farther_in_any_order():
    near, far = cube((0.2, 0, 0.04), RED), cube((-0.2, 0, -0.04), BLUE)
    for red, _, blue in (middle(near, far), middle(far, near)):
        assert red > 100
        assert blue == 0


def test_a_cube_without_opacity_is_not_seen():
    assert (middle(cube((0, 0, 0), RED, opacity=0.0)) == 255).all()


def test_lines_lie_below_cubes_or_over_them():
    line = [Segment(np.array([(0.0, -1.0, 0.0), (0.0, 1.0, 0.0)]), (0, 255, 0), width=4)]
    red, _, _ = np.asarray(draw([cube((0, 0, 0), RED)], eye(), size=SIZE, below=line))[SIZE // 2, SIZE // 2]
    _, green, _ = np.asarray(draw([cube((0, 0, 0), RED)], eye(), size=SIZE, over=line))[SIZE // 2, SIZE // 2]
    assert red > 100
    assert green > 200
