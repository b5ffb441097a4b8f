"""Check stored arrays against each other and against the scene's description."""

import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from jaxtyping import Float, Integer

from datagen import schema
from datagen.config import Sensor
from datagen.scene import Body
from datagen.shapes.shape import Shape
from datagen.verify.scene_case import Case, Finding

RELATIVE = 1e-5
"""Largest relative difference attributed to rounding to float32."""

DEVIATIONS = 8.0
"""Standard deviations allowed for normal noise; about one pixel in 10^15 exceeds them."""

MANY = 30
"""Least number of pixels for a meaningful median."""

Expected = Callable[[Body, Shape], object]

DESCRIBED: dict[str, Expected] = {
    "objects/category": lambda body, shape: body.category,
    "objects/parameters": lambda body, shape: json.dumps(dataclasses.asdict(body.shape)),
    "objects/motion": lambda body, shape: body.motion,
    "objects/size": lambda body, shape: shape.size,
    "objects/color": lambda body, shape: [body.material.color, body.material.color2],
    "objects/pattern": lambda body, shape: body.material.pattern,
    "objects/material": lambda body, shape: body.material.name,
    "objects/roughness": lambda body, shape: body.material.roughness,
    "objects/metalness": lambda body, shape: body.material.metalness,
    "objects/mass": lambda body, shape: body.density * shape.volume,
    "objects/inertia": lambda body, shape: body.density * shape.inertia,
    "objects/friction": lambda body, shape: body.friction,
    "objects/restitution": lambda body, shape: body.restitution,
    "objects/symmetry": lambda body, shape: shape.symmetry,
    "objects/minimum_box_center": lambda body, shape: shape.minimum_box.center,
    "objects/minimum_box_rotation": lambda body, shape: shape.minimum_box.rotation,
    "objects/minimum_box_size": lambda body, shape: shape.minimum_box.size,
}
"""Expected value of each stored field of an object, from its description and built shape."""


def check_schema(record: Mapping[str, np.ndarray], groups: tuple[str, ...]) -> Iterator[Finding]:
    """Check names, dtypes, axes, padding and finiteness."""
    try:
        schema.validate(record, groups)
    except schema.SchemaError as error:
        yield Finding("schema", str(error))
        return
    count = int(record["objects/count"])
    for name, array in record.items():
        yield from _check_padding(name, array, count)
        if array.dtype.kind == "f" and not np.all(np.isfinite(array) | ((name == "contacts/gap") & (array > 0))):
            yield Finding("schema", f"{name} holds values that are not finite")


def _check_padding(name: str, array: np.ndarray, count: int) -> Iterator[Finding]:
    used = {"object": count, "object+1": count + 1}
    for axis, kind in enumerate(schema.FIELDS[name].axes):
        if kind not in used:
            continue
        padding = np.moveaxis(array, axis, 0)[used[kind] :]
        if np.any(padding != (np.inf if name == "contacts/gap" else np.zeros((), array.dtype))):
            yield Finding("schema", f"{name} is not empty beyond its {used[kind]} rows in use")


def check_description(case: Case) -> Iterator[Finding]:
    """Check that stored cameras, lights and objects match the description."""
    record, scene = case.record, case.scene
    yield from _equal(record, "objects/count", case.count)
    yield from _equal(record, "camera/world_from_camera", [camera.world_from_camera for camera in scene.cameras])
    if "camera/world_from_camera_of_frame" in record:
        frames = range(scene.frames)
        paths = [[camera.at(frame).world_from_camera for camera in scene.cameras] for frame in frames]
        yield from _equal(record, "camera/world_from_camera_of_frame", paths)
    if "camera/K" in record:
        height, width = record["segmentation"].shape[2:]
        yield from _equal(record, "camera/K", [camera.k(width, height) for camera in scene.cameras])
    yield from _equal(record, "lights/direction", [light.direction for light in scene.lights])
    yield from _equal(record, "lights/radiance", [light.radiance for light in scene.lights])
    yield from _equal(record, "lights/ambient", scene.ambient)
    for name, expected in DESCRIBED.items():
        rows = [expected(body, shape) for body, shape in zip(scene.bodies, case.shapes, strict=True)]
        yield from _equal({name: record[name][: case.count]}, name, rows) if rows else ()


def _equal(record: Mapping[str, np.ndarray], name: str, expected: object) -> Iterator[Finding]:
    stored = record[name]
    if stored.dtype.kind == "S":
        equal = [text.decode() for text in stored.ravel().tolist()] == np.ravel(np.asarray(expected)).tolist()
    else:
        wanted = np.asarray(expected, np.float64)
        scale = np.max(np.abs(wanted), initial=1e-30)
        equal = stored.shape == wanted.shape and bool(np.all(np.abs(stored - wanted) <= RELATIVE * scale))
    if not equal:
        yield Finding("description", f"{name} is not what scene/description says")


def check_counts(case: Case) -> Iterator[Finding]:
    """Check that visible pixels, fractions and 2D boxes match the segmentation."""
    record = case.record
    visible, amodal = record["visibility/visible_pixels"], record["visibility/amodal_pixels"]
    fraction = np.where(amodal > 0, visible / np.maximum(amodal, 1), 0)
    if np.any(np.abs(fraction - record["visibility/visible_fraction"]) > 1e-6):
        yield Finding("counts", "visibility/visible_fraction is not visible_pixels over amodal_pixels")
    for frame, view in case.images:
        labels = case.segmentation(frame, view)
        counted = np.bincount(labels.ravel(), minlength=256)[1 : visible.shape[2] + 1]
        if np.any(counted != visible[frame, view]):
            message = f"stored {visible[frame, view].tolist()}, counted {counted.tolist()} visible pixels"
            yield Finding("counts", message, frame=frame, view=view)
        if np.any(visible[frame, view] > amodal[frame, view]):
            yield Finding("counts", "an object shows more pixels than it would alone", frame=frame, view=view)
        boxes = np.array([tight_box(labels == row + 1) for row in range(visible.shape[2])])
        if np.any(boxes != record["boxes/box_2d"][frame, view]):
            yield Finding("counts", "boxes/box_2d are not the boxes of the ids", frame=frame, view=view)


def tight_box(mask: np.ndarray) -> Integer[np.ndarray, "4"]:
    """Bounding box x0 y0 x1 y1 of a mask, ends exclusive; zeros for an empty mask."""
    columns, rows = np.flatnonzero(np.any(mask, axis=0)), np.flatnonzero(np.any(mask, axis=1))
    if not len(rows):
        return np.zeros(4, int)
    return np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1])


def check_sensor(case: Case) -> Iterator[Finding]:
    """Check that sensor depth matches its validity mask, lies on surfaces, and is no noisier than the recipe allows."""
    record = case.record
    depth, sensed, valid = record["depth"], record["sensor_depth"], record["sensor_valid"].astype(bool)
    if np.any(valid != (sensed > 0)):
        yield Finding("sensor", "sensor_valid is not where sensor_depth is positive")
    if np.any(valid & (depth == 0)):
        yield Finding("sensor", "the sensor returns depth where there is nothing")
        return
    sensor, far = case.allowed.sensor, depth * schema.DEPTH_SCALE
    beyond = valid & ((far < sensor.nearest - schema.DEPTH_SCALE) | (far > sensor.farthest + schema.DEPTH_SCALE))
    if np.any(beyond):
        yield Finding("sensor", f"{np.count_nonzero(beyond)} pixels return a depth from outside of the sensor's range")
    exact, measured = (array[valid & (sensed > 0)] * schema.DEPTH_SCALE for array in (depth, sensed))
    yield from _check_noise(exact, measured, case.allowed.sensor)
    yield from _check_bias(exact, measured, case.allowed.sensor)


def _check_noise(
    exact: Float[np.ndarray, "pixel"], measured: Float[np.ndarray, "pixel"], sensor: Sensor
) -> Iterator[Finding]:
    """Check each pixel: allow 8 standard deviations of noise, quantised inverse depth, and rounding of both depths."""
    half, step = 0.51 * (schema.DEPTH_SCALE + sensor.depth_step), 0.5 * sensor.quantisation
    most = DEVIATIONS * sensor.axial_noise * exact**2 + half
    low = 1 / (1 / (measured - half) + step)
    high = 1 / np.maximum(1 / (measured + half) - step, 1e-9)
    wrong = (low > exact + most) | (high < exact - most)
    if np.any(wrong):
        worst = np.max(np.abs(measured - exact)[wrong])
        message = f"{np.count_nonzero(wrong)} pixels are up to {1e3 * worst:.1f} mm off depth, more than their noise"
        yield Finding("sensor", message)


def _check_bias(
    exact: Float[np.ndarray, "pixel"], measured: Float[np.ndarray, "pixel"], sensor: Sensor
) -> Iterator[Finding]:
    """Check the median of all pixels whose noise was not clipped; their noise is symmetric."""
    noise = sensor.axial_noise * exact
    whole = (DEVIATIONS * noise < 1) & (exact * (1 + DEVIATIONS * noise) < schema.MAX_DEPTH)
    count = np.count_nonzero(whole)
    if count < MANY:
        return
    farthest = np.max(exact[whole])
    # The median of n values of this noise deviates less than their mean would with n / 8 standard deviations.
    spread = DEVIATIONS * sensor.axial_noise * farthest / np.sqrt(count)
    steps = sensor.quantisation * farthest + (schema.DEPTH_SCALE + sensor.depth_step) / np.min(exact[whole])
    bias = abs(np.median(measured[whole] / exact[whole]) - 1)
    if bias > spread + steps:
        message = f"the median of sensor_depth is {100 * bias:.2f} % off depth (allowed {100 * (spread + steps):.2f} %)"
        yield Finding("sensor", message)
