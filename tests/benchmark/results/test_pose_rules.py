import numpy as np
import pytest

from benchmark.results.pose_rules import pose_fault
from tests.worlds.sphere_clips import arbitrary

IMAGES = arbitrary(0).depth.shape[:2]


def poses(**changes: np.ndarray | None) -> dict[str, np.ndarray | None]:
    """Three labels in every image, the first without a pose."""
    center, rotation = np.ones((*IMAGES, 3, 3)), np.broadcast_to(np.eye(3), (*IMAGES, 3, 3, 3)).copy()
    arrays: dict[str, np.ndarray | None] = {"center": center, "rotation": rotation, "size": center.copy()}
    for array in (center, rotation, arrays["size"]):
        assert array is not None
        array[:, :, 0] = np.nan
    return arrays | changes


def test_good_poses_have_no_fault():
    assert pose_fault(poses(), (IMAGES[0], IMAGES[1])) == ""
    assert pose_fault(poses(rotation=None, size=None), (IMAGES[0], IMAGES[1])) == ""
    assert pose_fault({}, (IMAGES[0], IMAGES[1])) == ""
    nothing = {name: np.full_like(array, np.nan) for name, array in poses().items() if array is not None}
    assert pose_fault(nothing, (IMAGES[0], IMAGES[1])) == ""
    single = {name: array.astype(np.float32) for name, array in poses().items() if array is not None}
    assert pose_fault(single, (IMAGES[0], IMAGES[1])) == ""


@pytest.mark.parametrize("name", ["center", "rotation", "size"])
@pytest.mark.parametrize(
    ("value", "word"), [(np.inf, "infinite"), (-np.inf, "infinite"), (np.nan, "partly nan"), (1e9, "beyond")]
)
def test_the_first_faulty_pose_is_named(name: str, value: float, word: str):
    arrays = poses()
    array = arrays[name]
    assert array is not None
    array[1, 0, 2].flat[1] = value
    fault = pose_fault(arrays, (IMAGES[0], IMAGES[1]))
    assert fault.startswith(f"of frame 1, view 0, label 2 the {name} is {word}")


@pytest.mark.parametrize("missing", ["rotation", "size"])
def test_a_row_is_there_as_a_whole(missing: str):
    arrays = poses()
    array = arrays[missing]
    assert array is not None
    array[0, 0, 1] = np.nan
    assert f"only one of center and {missing} is given" in pose_fault(arrays, (IMAGES[0], IMAGES[1]))
