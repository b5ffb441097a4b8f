import pytest
import torch

from obpose.scenes.appearance.light import beams, is_light, no_light


@pytest.mark.parametrize("toward", [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.48, -0.6, 0.64], [1.0, 0.0, 0.0]])
def test_beams_lie_evenly_around_the_middle_of_the_light(toward: list[float]):
    middle = torch.tensor(toward)
    several = beams(middle)
    torch.testing.assert_close(several.norm(dim=-1), torch.ones(4))
    torch.testing.assert_close(torch.nn.functional.normalize(several.sum(dim=0), dim=0), middle)
    angles = torch.rad2deg((several @ middle).clamp(max=1).acos())
    torch.testing.assert_close(angles, angles[:1].expand(4), atol=0.01, rtol=0)
    assert 2 < float(angles[0]) < 5


@pytest.mark.parametrize(
    ("light", "is_one"),
    [
        ([0.0, 0.0, 0.0, 0.0], True),
        ([0.6, 0.0, 0.8, 0.3], True),
        ([0.6, 0.0, 0.8, 1.0], True),
        ([0.6, 0.0, 0.8, 1.1], False),
        ([0.6, 0.0, 0.8, -0.1], False),
        ([0.6, 0.0, 0.7, 0.3], False),
        ([0.0, 0.0, 0.0, 0.3], False),
        ([0.6, 0.0, 0.8, float("nan")], False),
        ([float("nan"), 0.0, 0.8, 0.3], False),
    ],
)
def test_a_light_has_a_direction_and_takes_a_share(light: list[float], is_one: bool):
    assert is_light(torch.tensor(light)) is is_one


def test_none_is_a_light_of_no_strength_and_of_the_same_numbers():
    assert is_light(no_light())
    assert not no_light().any()
    assert no_light(torch.ones(2, dtype=torch.float64)).dtype == torch.float64
