"""Convert simulated and rendered scenes to the arrays of the format, and back."""

import json
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Float, UInt8

from datagen.config import Sensor
from datagen.geometry import transform
from datagen.render.renderer import Image, Renderer, render_clip, stack_images
from datagen.scene import Body, Scene, Trajectory, plain, scene_from_json, scene_to_json
from datagen.schema import FIELDS, SceneRecord, encode_depth
from datagen.sensor import sense
from datagen.shapes.shape import Shape

_FARTHEST = 1e6
"""Largest value of a pose or velocity."""
_PATHS = "camera/world_from_camera_of_frame"
_POSES = ("position", "quaternion_wxyz", "linear_velocity", "angular_velocity")


def simulation_record(
    scene: Scene,
    shapes: Sequence[Shape],
    trajectory: Trajectory,
    *,
    rows: int,
    attempts: int,
    rejections: Mapping[str, int],
) -> SceneRecord:
    """All fields that need no renderer; `rows` is the length of the object axis, padded where it is not in use.

    `attempts` samples were drawn until one met the recipe's rules; `rejections` counts the others by reason.
    """
    return {
        **_surroundings(scene),
        "objects/count": np.asarray(len(scene.bodies), np.uint8),
        **_object_fields(scene.bodies, shapes, rows),
        **{f"poses/{name}": _padded(getattr(trajectory, name), rows, axes=(1,)) for name in _POSES},
        "contacts/gap": _padded(trajectory.contact_gap, rows + 1, axes=(1, 2), fill=np.inf),
        "contacts/impulse": _padded(trajectory.contact_impulse, rows + 1, axes=(1, 2)),
        "scene/attempts": np.asarray(attempts, np.uint16),
        "scene/rejections": _text([json.dumps(dict(sorted(rejections.items())))])[0, ...],
    }


def scene_and_trajectory(record: SceneRecord) -> tuple[Scene, Trajectory]:
    """Recover the scene and trajectory from which a record was made.

    Raises:
        ValueError, KeyError or TypeError: its description is not that of a scene, or does not fit its poses.
    """
    scene = scene_from_json(record["scene/description"].item().decode())
    rows, frames = len(scene.bodies), len(record["poses/position"])
    if rows != record["objects/count"] or scene.frames != frames:
        raise ValueError(
            f"it has {rows} objects in {scene.frames} frames, but there are poses of {record['objects/count']} objects "
            f"in {frames} frames"
        )
    if wrong := [len(camera.path) for camera in scene.cameras if len(camera.path) not in (0, 1, frames)]:
        raise ValueError(f"a camera has {wrong[0]} poses in {frames} frames")
    poses = {name: record[f"poses/{name}"][:, :rows] for name in _POSES}
    if wrong := [name for name, values in poses.items() if not np.all(np.abs(values) <= _FARTHEST)]:
        raise ValueError(f"poses/{wrong[0]} holds values that are not finite, or beyond {_FARTHEST:g}")
    gap, impulse = (record[f"contacts/{name}"][:, : rows + 1, : rows + 1] for name in ("gap", "impulse"))
    return scene, Trajectory(**poses, contact_gap=gap, contact_impulse=impulse)


def with_scene(record: SceneRecord, scene: Scene) -> SceneRecord:
    """Copy of `record` whose cameras, lights and description are those of `scene`, which has the same objects."""
    return {**{name: array for name, array in record.items() if name != _PATHS}, **_surroundings(scene)}


def _surroundings(scene: Scene) -> SceneRecord:
    moving = any(camera.moves for camera in scene.cameras)
    return {
        **({_PATHS: _camera_paths(scene)} if moving else {}),
        "camera/world_from_camera": np.stack([camera.world_from_camera for camera in scene.cameras]),
        "lights/direction": np.array([light.direction for light in scene.lights], np.float64),
        "lights/radiance": np.array([light.radiance for light in scene.lights], np.float64),
        "lights/ambient": np.array(scene.ambient, np.float64),
        "scene/description": _text([scene_to_json(scene)])[0, ...],
    }


def _camera_paths(scene: Scene) -> Float[np.ndarray, "frame view 4 4"]:
    frames = range(scene.frames)
    return np.array([[camera.at(frame).world_from_camera for camera in scene.cameras] for frame in frames])


def _object_fields(bodies: Sequence[Body], shapes: Sequence[Shape], rows: int) -> SceneRecord:
    if bodies:
        return {f"objects/{name}": _padded(array, rows) for name, array in _object_arrays(bodies, shapes).items()}
    fields = [field for name, field in FIELDS.items() if name.startswith("objects/") and field.axes]
    return {f.name: np.zeros((rows, *map(int, f.axes[1:])), "S1" if f.dtype == "S" else f.dtype) for f in fields}


def _object_arrays(bodies: Sequence[Body], shapes: Sequence[Shape]) -> dict[str, np.ndarray]:
    boxes = [shape.minimum_box for shape in shapes]
    return {
        "category": _text(body.category for body in bodies),
        "parameters": _text(json.dumps(plain(body.shape)) for body in bodies),
        "motion": _text(body.motion for body in bodies),
        "size": _floats(shape.size for shape in shapes),
        "color": _floats((body.material.color, body.material.color2) for body in bodies),
        "pattern": _text(body.material.pattern for body in bodies),
        "material": _text(body.material.name for body in bodies),
        "roughness": _floats(body.material.roughness for body in bodies),
        "metalness": _floats(body.material.metalness for body in bodies),
        "mass": _floats(body.density * shape.volume for body, shape in zip(bodies, shapes, strict=True)),
        "inertia": _floats(body.density * shape.inertia for body, shape in zip(bodies, shapes, strict=True)),
        "friction": _floats(body.friction for body in bodies),
        "restitution": _floats(body.restitution for body in bodies),
        "symmetry": _text(shape.symmetry for shape in shapes),
        "minimum_box_center": _floats(box.center for box in boxes),
        "minimum_box_rotation": _floats(box.rotation for box in boxes),
        "minimum_box_size": _floats(box.size for box in boxes),
    }


def pixel_record(
    scene: Scene,
    shapes: Sequence[Shape],
    trajectory: Trajectory,
    renderer: Renderer,
    *,
    resolution: tuple[int, int],
    rows: int,
    sensor: Sensor,
    rng: np.random.Generator,
) -> SceneRecord:
    """All fields that come with images of this width and height; `rows` is the length of the object axis.

    Sensor fields are included only if the sensor is enabled; `rng` draws its noise.

    Raises:
        UsageError: a depth is farther than the format can hold.
    """
    images = render_clip(scene, shapes, trajectory.world_from_object, renderer, resolution)
    k = np.stack([camera.k(*resolution) for camera in scene.cameras])
    # Pixels of each object, with and without the others in front of it.
    segmentation = stack_images(images, "segmentation")
    visible = visible_pixels(segmentation, len(shapes))
    amodal = stack_images(images, "amodal_pixels").astype(np.uint32)
    fraction = (visible / np.maximum(amodal, 1)).astype(np.float32)
    return {
        "rgb": stack_images(images, "rgb"),
        "depth": encode_depth(stack_images(images, "depth")),
        "segmentation": segmentation,
        **(_sensed(images, k, sensor, rng) if sensor.enabled else {}),
        "camera/K": k,
        "visibility/visible_pixels": _padded(visible, rows, axes=(2,)),
        "visibility/amodal_pixels": _padded(amodal, rows, axes=(2,)),
        "visibility/visible_fraction": _padded(fraction, rows, axes=(2,)),
        "boxes/box_2d": _padded(boxes_2d(segmentation, len(shapes)), rows, axes=(2,)),
        "boxes/box_3d": _padded(_boxes_3d(shapes, trajectory), rows, axes=(1,)),
    }


def _sensed(images: list[list[Image]], k: np.ndarray, sensor: Sensor, rng: np.random.Generator) -> SceneRecord:
    pairs = [
        [sense(image.depth, image.rgb, k[view], sensor, rng) for view, image in enumerate(views)] for views in images
    ]
    depth = np.array([[depth for depth, _ in views] for views in pairs])
    valid = np.array([[valid for _, valid in views] for views in pairs], np.uint8)
    return {"sensor_depth": encode_depth(depth), "sensor_valid": valid}


def visible_pixels(segmentation: UInt8[np.ndarray, "frame view height width"], objects: int) -> np.ndarray:
    """Number of pixels of each object, uint32 [frame view object]."""
    images = segmentation.reshape(*segmentation.shape[:2], -1)
    counts = [np.count_nonzero(images == row + 1, axis=-1) for row in range(objects)]
    return np.array(counts, np.uint32).reshape(objects, *images.shape[:2]).transpose(1, 2, 0)


def boxes_2d(segmentation: UInt8[np.ndarray, "frame view height width"], objects: int) -> np.ndarray:
    """Box x0 y0 x1 y1 of the visible pixels of each object, uint16 [frame view object 4]; zeros if it shows none."""
    boxes = np.zeros((*segmentation.shape[:2], objects, 4), np.uint16)
    for row in range(objects):
        mask = segmentation == row + 1
        boxes[:, :, row, 0::2] = _extent(mask.any(axis=2))
        boxes[:, :, row, 1::2] = _extent(mask.any(axis=3))
    return boxes


def _extent(used: np.ndarray) -> np.ndarray:
    """First used position and the one after the last, along the last axis; zeros if none is used."""
    first, last = np.argmax(used, axis=-1), used.shape[-1] - np.argmax(used[..., ::-1], axis=-1)
    return np.stack([first, last], axis=-1) * np.any(used, axis=-1, keepdims=True)


def _boxes_3d(shapes: Sequence[Shape], trajectory: Trajectory) -> Float[np.ndarray, "frame object 8 3"]:
    corners = [shape.minimum_box.corners for shape in shapes]
    frames = [zip(poses, corners, strict=True) for poses in trajectory.world_from_object]
    boxes = np.array([[transform(pose, points) for pose, points in pairs] for pairs in frames], np.float32)
    return boxes.reshape(len(trajectory.position), len(shapes), 8, 3)


def _padded(array: np.ndarray, rows: int, *, axes: tuple[int, ...] = (0,), fill: float = 0) -> np.ndarray:
    missing = [(0, rows - length if axis in axes else 0) for axis, length in enumerate(array.shape)]
    if array.dtype.kind == "S":
        return np.concatenate([array, np.zeros(missing[0][1], array.dtype)])
    return np.pad(array, missing, constant_values=fill)


def _floats(values: Iterable[object]) -> np.ndarray:
    return np.array(list(values), np.float32)


def _text(values: Iterable[str]) -> np.ndarray:
    return np.array([value.encode("ascii") for value in values])
