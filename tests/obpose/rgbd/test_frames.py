import pytest

from obpose.config import Config, override
from obpose.contact.config import ContactConfig
from obpose.errors import UsageError
from obpose.rgbd.frames import trained_on
from obpose.systems import find_system


@pytest.mark.parametrize(
    ("center", "middle"),
    [((-0.12, 0.0, 0.07), (0.0, 0.0, 0.0)), ((0.6, -2.0, 0.1), (0.35, -1.75, 0.0))],
)
def test_the_table_middle_is_the_origin_if_that_is_in_the_workspace(
    center: tuple[float, float, float], middle: tuple[float, float, float]
):
    config = override(Config(), {"model.workspace_center": center, "model.workspace_size": 1.0, "model.spacing": 0.02})
    trained = trained_on(config)
    assert trained.center == pytest.approx(middle)
    assert trained.spacing == 0.02
    assert trained.cube == (center, 1.0)


def test_the_contact_model_has_no_bounds():
    config = override(ContactConfig(), {"model.workspace_center": (0.1, 0.2, 0.3), "model.spacing": 0.02})
    assert trained_on(config).center == (0.1, 0.2, 0.0)
    assert trained_on(config).cube is None


def test_weights_of_other_systems_are_refused():
    with pytest.raises(UsageError, match="Weights of obsurf cannot segment your own frames"):
        trained_on(find_system("obsurf").config())
