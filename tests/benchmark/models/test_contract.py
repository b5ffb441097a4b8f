import numpy as np
import pytest

from benchmark.models.contract import BadPrediction, check_prediction, pose_fault
from benchmark.models.interface import Poses, Prediction
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


CLIP = arbitrary(0)
GOOD = np.zeros((2, 2, 3, 3))
TURNED = np.broadcast_to(np.eye(3), (2, 2, 3, 3, 3))


def unchecked(**arrays: np.ndarray) -> Poses:
    """Arrays that do not fit each other: outside of tests nothing looks at their axes."""
    poses = Poses(GOOD)
    for name, array in arrays.items():
        object.__setattr__(poses, name, array)
    return poses


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        (Poses(GOOD[:1]), r"center of poses float64 \(1, 2, 3, 3\)"),
        (unchecked(rotation=TURNED[:, :, :2]), "rotation of poses"),
        (Poses(GOOD, TURNED, GOOD - 1), "size is negative"),
        (Poses(GOOD, size=GOOD), "without rotation"),
        (Poses(GOOD, 2 * TURNED), "not a rotation matrix"),
        (Poses(GOOD, -TURNED), "not a rotation matrix"),
        (Poses(np.full_like(GOOD, np.nan), TURNED), "only one of center and rotation is given"),
        (Poses(np.zeros((2, 2, 257, 3))), "poses of 257 labels; expected at most 256"),
        (unchecked(center=GOOD.astype(int)), "center of poses int64"),
        (unchecked(center=GOOD[0]), r"center of poses float64 \(2, 3, 3\); expected floats of \(2, 2, label, 3\)"),
    ],
)
def test_poses_that_are_none_are_refused(poses: Poses, message: str):
    labels = np.zeros(CLIP.depth.shape, np.int64)
    check_prediction(Prediction(labels, 0, poses=Poses(GOOD, TURNED, GOOD)), CLIP, "scene 0")
    with pytest.raises(BadPrediction, match=message):
        check_prediction(Prediction(labels, 0, poses=poses), CLIP, "scene 0")
