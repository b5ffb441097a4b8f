"""Checks of predictions against the contract of `benchmark.models.interface`, from models and from files."""

from collections.abc import Collection, Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike

from benchmark.models.interface import LARGEST_LABEL, Clip, Poses, Prediction
from datagen.errors import DatagenError

ARRAYS = {"center": (3,), "rotation": (3, 3), "size": (3,)}
"""Names of the arrays of poses, and the shape of one pose in each."""
MOST_METRES = 1e6
"""Largest coordinate and side length; beyond it squares lose all precision."""
UNIT_TOLERANCE = 1e-3
"""Largest deviation of a rotation's columns from orthonormal ones."""


class BadPrediction(DatagenError):
    """A model broke the contract of `benchmark.models.interface`."""


def check_prediction(prediction: Prediction, clip: Clip, where: str, extra: Collection[str] = ()) -> None:
    """Check that a model gave a label for every pixel, also in each of the `extra` segmentations, and valid poses.

    Raises:
        BadPrediction: the prediction is invalid; the message describes it.
    """
    if not isinstance(prediction, Prediction):
        raise BadPrediction(f"In {where} the model gave a {type(prediction).__name__}; expected a Prediction.")
    if missing := sorted(set(extra) - set(prediction.extra)):
        raise BadPrediction(f"In {where} the model gave no {missing[0]!r} in `extra`, which it declares.")
    for labels in (prediction.labels, *(prediction.extra[name] for name in extra)):
        _check_labels(np.asarray(labels), prediction.background_slot, clip, where)
    if prediction.poses is not None:
        _check_poses(prediction.poses, clip, where)


def check_reconstruction(images: object, count: int, clip: Clip, where: str) -> None:
    """Check that a model rendered `count` images of a clip, none of them larger than the clip's.

    Raises:
        BadPrediction: it did not; the message describes the images.
    """
    height, width = clip.depth.shape[2:]
    found = f"{images.dtype} {images.shape}" if isinstance(images, np.ndarray) else type(images).__name__
    sizes = [(count,), range(1, height + 1), range(1, width + 1), (3,)]
    shape = images.shape if isinstance(images, np.ndarray) and images.dtype == np.uint8 else ()
    if len(shape) != 4 or not all(size in good for size, good in zip(shape, sizes, strict=True)):
        raise BadPrediction(
            f"In {where} the model gave a reconstruction {found}; expected uint8 of shape ({count}, height, width, 3), "
            f"at most {height} x {width} pixels."
        )


def _check_labels(labels: np.ndarray, slot: int | None, clip: Clip, where: str) -> None:
    if labels.shape != clip.depth.shape or not np.issubdtype(labels.dtype, np.integer):
        nan = " with nan" if labels.dtype.kind == "f" and np.isnan(labels).any() else ""
        expected = f"integers of shape {clip.depth.shape}"
        raise BadPrediction(
            f"In {where} the model gave labels {labels.dtype} {labels.shape}{nan}; expected {expected}."
        )
    for value in (labels.min(), labels.max(), 0 if slot is None else slot):
        if not 0 <= value <= LARGEST_LABEL:
            raise BadPrediction(
                f"In {where} the model gave label or background slot {value}; expected 0 to {LARGEST_LABEL}."
            )


def _check_poses(poses: Poses, clip: Clip, where: str) -> None:
    frames, views = clip.depth.shape[:2]
    arrays = {name: None if (array := getattr(poses, name)) is None else np.asarray(array) for name in ARRAYS}
    if fault := pose_fault(arrays, (frames, views)):
        raise BadPrediction(f"In {where} the model gave {fault}.")


def pose_fault(arrays: Mapping[str, np.ndarray | None], images: tuple[int, int]) -> str:
    """Describe what is wrong with the poses of a clip, and what was expected; empty if nothing is wrong.

    `arrays` are some of `ARRAYS` by name, each [frame, view, label, ...]; `images` are the numbers of frames and views.
    """
    given = {name: array for name in ARRAYS if (array := arrays.get(name)) is not None}
    if given and "center" not in given:
        return f"{', '.join(given)} without center; expected center as well"
    if "size" in given and "rotation" not in given:
        return "size without rotation; expected both, as sides are measured along the axes of the box"
    if fault := _shape_fault(given, images):
        return fault
    return next(_value_faults({name: np.asarray(array, np.float64) for name, array in given.items()}), "")


def _shape_fault(given: Mapping[str, np.ndarray], images: tuple[int, int]) -> str:
    center = given.get("center")
    labels = center.shape[2] if center is not None and center.ndim == 4 else "label"
    for name, array in given.items():
        expected = (*images, labels, *ARRAYS[name])
        if array.shape != expected or array.dtype.kind != "f":
            shape = str(expected).replace("'", "")
            return f"{name} of poses {array.dtype} {array.shape}; expected floats of {shape}, [frame view label ...]"
    if isinstance(labels, int) and labels > LARGEST_LABEL + 1:
        return f"poses of {labels} labels; expected at most {LARGEST_LABEL + 1}"
    return ""


def _value_faults(given: Mapping[str, np.ndarray]) -> Iterator[str]:
    """Yield the faults of single poses; all numbers of a label without a pose are nan."""
    there = {name: ~np.isnan(array).all(axis=tuple(range(3, array.ndim))) for name, array in given.items()}
    for name, array in given.items():
        inner = tuple(range(3, array.ndim))
        yield from _fault(np.isinf(array).any(axis=inner), f"{name} is infinite; expected numbers, or nan in all of it")
        yield from _fault(np.isnan(array).any(axis=inner) & there[name], f"{name} is partly nan; expected all or none")
        far = np.any(np.abs(np.nan_to_num(array)) > MOST_METRES, axis=inner)
        yield from _fault(far, f"{name} is beyond {MOST_METRES:,.0f} m")
        only = there[name] != there["center"]
        yield from _fault(only, f"only one of center and {name} is given; expected both, or nan in both")
    if "size" in given:
        yield from _fault((given["size"] < 0).any(axis=3), "size is negative; expected 0 or more")
    if "rotation" in given:
        wrong = there["rotation"] & ~_are_rotations(np.nan_to_num(given["rotation"]))
        yield from _fault(wrong, "rotation is not a rotation matrix; expected orthonormal columns, determinant 1")


def _fault(wrong: ArrayLike, words: str) -> Iterator[str]:
    places = np.argwhere(wrong)
    if len(places):
        frame, view, label = places[0].tolist()
        yield f"of frame {frame}, view {view}, label {label} the {words}"


def _are_rotations(matrices: np.ndarray) -> np.ndarray:
    squares = np.swapaxes(matrices, -1, -2) @ matrices
    orthonormal = np.all(np.abs(squares - np.eye(3)) < UNIT_TOLERANCE, axis=(-2, -1))
    return orthonormal & (np.linalg.det(matrices) > 0)
