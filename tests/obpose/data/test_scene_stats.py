import pytest
import torch
from torch import Tensor

from obpose.data.scene_stats import measure_scene, neighbour_distances
from obpose.errors import UsageError
from obpose.systems import find_system
from obpose.types import Observation
from obpose.variants import make_config

HEIGHT, WIDTH, FOCAL = 20, 30, 50.0


class Wall:
    """A wall at a depth before a camera that stands at a place, seen straight on."""

    frames_of_clip = 3

    def __init__(
        self,
        clips: int = 40,
        depth: float = 2.0,
        place: tuple[float, float, float] = (0, 0, 0),
        holes=0.0,
        noise=0.0,
        width: int = WIDTH,
    ):
        self._clips, self._depth, self._place, self._holes, self._noise = clips, depth, place, holes, noise
        self._width = width
        self.read: list[tuple[int, int, int]] = []

    def __len__(self) -> int:
        return self._clips

    def window(self, index: int, start: int, frames: int) -> dict[str, Tensor]:
        self.read.append((index, start, frames))
        shape = (frames, 1, HEIGHT, self._width)
        generator = torch.Generator().manual_seed(index)
        valid = torch.rand(shape, generator=generator) >= self._holes
        pose = torch.eye(4)
        pose[:3, 3] = torch.tensor(self._place)
        k = torch.tensor([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
        depth = (self._depth + self._noise * torch.randn(shape, generator=generator)) * valid
        return {
            "rgb": torch.zeros(*shape, 3),
            "depth": depth,
            "valid": valid,
            "k": k[None],
            "world_from_camera": pose[None],
        }


def test_spacing_is_the_distance_between_neighbouring_pixels():
    assert measure_scene(Wall(depth=2.0)).spacing == pytest.approx(2.0 / FOCAL, rel=1e-5)
    assert measure_scene(Wall(depth=1.0, holes=0.5)).spacing == pytest.approx(1.0 / FOCAL, rel=1e-4)


def test_the_noise_is_that_of_the_points_of_a_plane():
    assert measure_scene(Wall()).noise == pytest.approx(0, abs=1e-6)
    assert measure_scene(Wall(noise=0.002)).noise == pytest.approx(0.002, rel=0.1)


@pytest.mark.parametrize(("width", "scale"), [(30, 1), (80, 1), (128, 2)])
def test_the_scale_of_images_is_their_width_in_units_of_64_pixels(width: int, scale: int):
    assert measure_scene(Wall(width=width)).image_scale == scale


def test_the_workspace_holds_almost_all_points_and_little_more():
    measures = measure_scene(Wall(place=(5.0, -3.0, 1.0)))
    assert measures.workspace_center == pytest.approx((5.0, -3.0, 3.0), abs=0.05)
    width = 2.0 * WIDTH / FOCAL
    assert 0.97 * width < measures.workspace_size < 1.05 * width


def test_the_background_s_cube_holds_the_cameras_and_all_points():
    assert measure_scene(Wall(clips=2, place=(5.0, -3.0, 1.0))).background_size == pytest.approx(4.0)
    assert measure_scene(Wall(clips=2, depth=0.2, width=300)).background_size == pytest.approx(
        0.2 * 299 / FOCAL, rel=0.01
    )


def test_a_few_clips_spread_over_the_source_are_read():
    source = Wall(clips=320)
    measure_scene(source)
    assert source.read == [(10 * i, 0, 1) for i in range(32)]
    few = Wall(clips=3)
    measure_scene(few)
    assert few.read == [(i, 0, 1) for i in range(3)]


def test_measures_are_changes_of_a_configuration():
    measures = measure_scene(Wall())
    config = make_config(**find_system("obpose").known(measures.changes()))
    assert config.model.spacing == measures.spacing
    assert config.model.workspace_center == measures.workspace_center
    assert config.model.workspace_size == measures.workspace_size


def test_clips_that_show_nothing_are_refused():
    with pytest.raises(UsageError, match="show nothing"):
        measure_scene(Wall(holes=1.0))


def test_no_clips_are_not_said_to_show_nothing():
    with pytest.raises(UsageError, match="There are no training clips; expected a training split"):
        measure_scene(Wall(clips=0))


def test_poses_that_are_no_numbers_are_refused():
    source = Wall()
    window = source.window
    source.window = lambda *place: {  # pyright: ignore[reportAttributeAccessIssue]
        name: value * float("nan") if name == "world_from_camera" else value for name, value in window(*place).items()
    }
    with pytest.raises(UsageError, match="not finite: their depths, camera matrices or poses"):
        measure_scene(source)


def test_only_pairs_with_both_depths_count():
    depth = torch.tensor([[1.0, 1.0, 0.0], [1.0, 0.0, 1.0]])[None, None, None]
    camera = torch.tensor([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1]])[None, None]
    image = Observation(torch.zeros(1, 1, 1, 2, 3, 3), depth, depth > 0, camera, torch.eye(4)[None, None])
    assert neighbour_distances(image).tolist() == pytest.approx([1.0, 1.0])
