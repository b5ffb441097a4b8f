import pytest
import torch

from obpose.errors import UsageError
from obpose.scenes import edit
from obpose.scenes.bounds import check_inside, workspace_bounds
from tests.obpose.scenes.small_scenes import some_model, some_scene

INSIDE = torch.tensor([0.1, -0.2, 0.05])


def test_objects_can_be_in_the_workspace_above_the_table():
    """Half a metre around the origin, and not in the background's cube of 2.5 m."""
    model = some_model()
    low, high = workspace_bounds(model)
    assert low.tolist() == [-0.5, -0.5, 0.0]
    assert high.tolist() == [0.5, 0.5, 0.5]
    check_inside(edit.move_to(some_scene(frames=1), 1, INSIDE), model)


@pytest.mark.parametrize(
    "to", [(0.6, 0.0, 0.1), (0.0, -0.6, 0.1), (0.0, 0.0, -0.1), (0.0, 0.0, 0.6), (-1.17, 0.0, 0.1)]
)
def test_an_object_elsewhere_is_named_with_where_it_could_be(to: tuple[float, float, float]):
    moved = edit.move_to(some_scene(frames=1), 2, torch.tensor(to))
    expected = r"Object 2 would be outside.*x -0\.50 to 0\.50, y -0\.50 to 0\.50, z 0\.00 to 0\.50 m"
    with pytest.raises(UsageError, match=expected):
        check_inside(moved, some_model())


def test_all_frames_count():
    moved = edit.move_to(some_scene(frames=2), 2, INSIDE)
    moved.center[1, 1, 0] = 0.7
    with pytest.raises(UsageError, match="Object 2 would be"):
        check_inside(moved, some_model())


def test_a_thin_object_may_sink_a_little():
    check_inside(edit.move_to(some_scene(frames=1), 1, torch.tensor([0.0, 0.0, -0.0025])), some_model())


def test_the_workspace_begins_at_the_table_of_the_model():
    low, _ = workspace_bounds(some_model(**{"model.table": 0.101}))
    assert low.tolist() == pytest.approx([-0.5, -0.5, 0.1])


def test_where_there_is_no_table_the_workspace_ends_below():
    low, _ = workspace_bounds(some_model(**{"model.table": None}))
    assert low.tolist() == [-0.5, -0.5, -0.5]
