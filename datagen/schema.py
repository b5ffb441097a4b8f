"""The dataset format: one table of fields from which writer, reader, validator and docs are derived.

A `SceneRecord` is a dict from field names to arrays of one scene. Shards stack records along a first axis `scene`.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from datagen.errors import UsageError

FORMAT_VERSION = 1
"""Version of the file format, raised when readers of the previous version would misread the files."""

DATA_VERSION = 1
"""Version of the data, raised when an existing array of any scene changes; new optional fields do not raise it."""

DEPTH_SCALE = 1e-4
"""Metres per unit of stored depth."""

MAX_DEPTH = 65535 * DEPTH_SCALE
"""The farthest depth that the format can hold, metres."""

GENERATOR = "obpose-datagen"

IMPORTER = f"{GENERATOR} import"
"""Generator of datasets whose scenes come from other projects; they hold only some fields and have no recipe."""

SPLITS = ("train", "val", "test")

EditKind = Literal["remove", "move", "add"]

EDITS: tuple[EditKind, ...] = get_args(EditKind)
"""Counterfactual edits that a dataset may store for each scene; each is a group of fields."""

Signal = Literal["flow", "tracks", "normals", "coordinates", "amodal"]

SIGNALS: tuple[Signal, ...] = get_args(Signal)
"""Optional signals that a dataset may store beside its images; each is a group of fields, see `datagen.signals`."""

NORMAL_SCALE = 32767
"""Stored units of a normal's component of 1; the direction is within 0.003 degrees."""

COORDINATE_SCALE = 65535
"""Stored units of a whole side of an object's minimum-volume box."""

SHOWN, HIDDEN, OUTSIDE, UNKNOWN = range(4)
"""Values of a flow's occlusion: the point shows there, another surface hides it, it leaves the image, it has no flow."""

LEAST_EFFECT = 24
"""Least difference of a pixel's summed channels (at most 765) that counts as an effect of an edit.

Removals also brighten the ambient light around an object, by at most 16, and slightly change the rims of other shadows,
because the shadow maps change.
"""

SceneRecord = dict[str, np.ndarray]


@dataclass(frozen=True)
class Field:
    """One array of the format."""

    name: str
    """Path of the array in the file."""
    dtype: str
    """NumPy name of the dtype; `S` stands for ASCII text of any fixed length."""
    axes: tuple[str, ...]
    """Axes of one scene's array; `object` is padded to the recipe's maximum, `object+1` has the table first."""
    unit: str
    frame: str
    """Frame of reference, `-` if there is none."""
    description: str
    group: str = "simulation"
    """Group that decides when the array exists. `simulation`: always; `moving_camera`: if cameras move; `pixels`: after
    rendering; `sensor`: with a recipe that has a depth sensor; `remove`, `move`, `add`: if the dataset was made with
    this edit; `flow`, `tracks`, `normals`, `coordinates`, `amodal`: if it was made with this signal. Imported datasets
    list their fields instead, see `datagen.storage.spec.fields_of`."""


_PIXELS = "frame view height width"


def _edit(kind: EditKind, edited: str, transform: str | None, ids: str) -> list[tuple[str, ...]]:
    moved = [(f"edits/{kind}/transform", "float64", "4 4", "m", "world", transform, kind)] if transform else []
    return [
        (f"edits/{kind}/object", "uint8", "", "id", "-", f"{edited}; 0 = none, and the images are the scene's own", kind),
        *moved,
        (f"edits/{kind}/rgb", "uint8", f"{_PIXELS} channel", "sRGB 0-255", "image", "colour of the edited scene", kind),
        (f"edits/{kind}/depth", "uint16", _PIXELS, "0.1 mm", "camera", "depth of the edited scene, exact", kind),
        (f"edits/{kind}/segmentation", "uint8", _PIXELS, "id", "image", ids, kind),
    ]  # fmt: skip


_STATES = "0 shown there, 1 hidden there, 2 outside the image, 3 no such frame"

_FIELDS = [
    ("rgb", "uint8", f"{_PIXELS} channel", "sRGB 0-255", "image", "colour, anti-aliased", "pixels"),
    ("depth", "uint16", _PIXELS, "0.1 mm", "camera", "planar z at the pixel's centre, 0 = no return", "pixels"),
    ("segmentation", "uint8", _PIXELS, "id", "image", "object id at the pixel's centre: row in objects/ plus 1, constant over frames and views; 0 = table and backdrop", "pixels"),
    ("sensor_depth", "uint16", _PIXELS, "0.1 mm", "camera", "depth as a noisy sensor sees it, 0 = no return", "sensor"),
    ("sensor_valid", "uint8", _PIXELS, "bool", "image", "1 where the sensor returned a depth", "sensor"),
    ("camera/K", "float64", "view 3 3", "pixel", "image", "camera matrix, pixel centres at +0.5; every image holds the recipe's frame, see docs/dataset.md", "pixels"),
    ("camera/world_from_camera", "float64", "view 4 4", "m", "world", "pose, OpenCV axes (x right, y down, z forward)", "simulation"),
    ("camera/world_from_camera_of_frame", "float64", "frame view 4 4", "m", "world", "pose in every frame; camera/world_from_camera is that of frame 0", "moving_camera"),
    ("lights/direction", "float64", "light 3", "1", "world", "unit vector towards each light; row 0 casts the shadow", "simulation"),
    ("lights/radiance", "float64", "light 3", "1", "-", "linear RGB on a surface that faces the light", "simulation"),
    ("lights/ambient", "float64", "3", "1", "-", "linear RGB of the light from everywhere", "simulation"),
    ("objects/count", "uint8", "", "1", "-", "rows in use below; the rest are padding: zeros, infinite gaps", "simulation"),
    ("objects/category", "S", "object", "-", "-", "name in the catalog", "simulation"),
    ("objects/parameters", "S", "object", "m, rad", "object", "family and its parameters, JSON", "simulation"),
    ("objects/motion", "S", "object", "-", "-", "what the object was meant to do: rest, drop, slide, roll, push, throw", "simulation"),
    ("objects/size", "float32", "object 3", "m", "object", "exact extents along the object's axes", "simulation"),
    ("objects/color", "float32", "object 2 3", "sRGB 0-1", "-", "first and second colour", "simulation"),
    ("objects/pattern", "S", "object", "-", "-", "layout of the two colours", "simulation"),
    ("objects/material", "S", "object", "-", "-", "name of the material", "simulation"),
    ("objects/roughness", "float32", "object", "1", "-", "0 mirror, 1 chalk", "simulation"),
    ("objects/metalness", "float32", "object", "1", "-", "0 dielectric, 1 metal", "simulation"),
    ("objects/mass", "float32", "object", "kg", "-", "density times volume", "simulation"),
    ("objects/inertia", "float32", "object 3 3", "kg m^2", "object", "about the centre of mass", "simulation"),
    ("objects/friction", "float32", "object", "1", "-", "Coulomb coefficient", "simulation"),
    ("objects/restitution", "float32", "object", "1", "-", "bounciness", "simulation"),
    ("objects/symmetry", "S", "object", "-", "object", "exact rotation group, see docs/dataset.md", "simulation"),
    ("objects/minimum_box_center", "float32", "object 3", "m", "object", "minimum-volume box: centre", "simulation"),
    ("objects/minimum_box_rotation", "float32", "object 3 3", "1", "object", "minimum-volume box: axes in columns", "simulation"),
    ("objects/minimum_box_size", "float32", "object 3", "m", "object", "minimum-volume box: side lengths", "simulation"),
    ("poses/position", "float32", "frame object 3", "m", "world", "centre of mass", "simulation"),
    ("poses/quaternion_wxyz", "float32", "frame object 4", "1", "world", "orientation", "simulation"),
    ("poses/linear_velocity", "float32", "frame object 3", "m/s", "world", "of the centre of mass", "simulation"),
    ("poses/angular_velocity", "float32", "frame object 3", "rad/s", "world", "", "simulation"),
    ("contacts/gap", "float32", "frame object+1 object+1", "m", "-", "distance of the convex hulls that physics uses (within 3 mm of the surfaces, exact for primitives), negative = overlap, inf beyond 2 cm; row 0 = table", "simulation"),
    ("contacts/impulse", "float32", "frame object+1 object+1", "N s", "-", "normal impulse since the frame before; row 0 = table", "simulation"),
    ("visibility/visible_pixels", "uint32", "frame view object", "pixel", "image", "pixels that carry the object's id", "pixels"),
    ("visibility/amodal_pixels", "uint32", "frame view object", "pixel", "image", "pixels it would have alone", "pixels"),
    ("visibility/visible_fraction", "float32", "frame view object", "1", "-", "visible over amodal, 0 where out of view", "pixels"),
    ("boxes/box_2d", "uint16", "frame view object 4", "pixel", "image", "x0 y0 x1 y1 of the visible pixels, ends exclusive; zeros if hidden", "pixels"),
    ("boxes/box_3d", "float32", "frame object 8 3", "m", "world", "corners of the minimum-volume box", "pixels"),
    ("scene/description", "S", "", "-", "-", "the scene before time starts, JSON", "simulation"),
    ("scene/attempts", "uint16", "", "1", "-", "samples drawn until one met the recipe's rules", "simulation"),
    ("scene/rejections", "S", "", "-", "-", "how many of these samples failed for which reason, JSON", "simulation"),
    *_edit("remove", "object that is gone", None, "ids of the edited scene; the others keep theirs"),
    ("edits/remove/effects", "uint8", f"{_PIXELS} byte", "bits", "image", "objects whose removal changes the pixel's colour although they do not show in it; bit k - 1 (bit 0 the lowest of byte 0) is object k", "remove"),
    *_edit("move", "object that is elsewhere", "where it was to where it is, the same in all frames", "ids of the edited scene, as in the scene itself"),
    *_edit("add", "object that there is a copy of", "where the object is to where its copy is, the same in all frames", "ids of the edited scene; the copy's is objects/count plus 1"),
    ("flow/forward", "float16", f"{_PIXELS} 2", "pixel", "image", "motion (x right, y down) of the point at the pixel's centre to the next frame; zeros where unknown", "flow"),
    ("flow/forward_occlusion", "uint8", _PIXELS, "state", "image", f"that point in the next frame: {_STATES}", "flow"),
    ("flow/backward", "float16", f"{_PIXELS} 2", "pixel", "image", "motion to the frame before", "flow"),
    ("flow/backward_occlusion", "uint8", _PIXELS, "state", "image", f"that point in the frame before: {_STATES}", "flow"),
    ("normals", "int16", f"{_PIXELS} 3", "1/32767", "camera", "unit surface normal at the pixel's centre, OpenCV axes; zeros without a surface", "normals"),
    ("object_coordinates", "uint16", f"{_PIXELS} 3", "1/65535", "object", "position in the object's minimum-volume box along its three axes, 0 to 1; zeros for table and backdrop", "coordinates"),
    ("amodal/rle", "S", "frame view object", "-", "image", "mask of the object as if alone, COCO's compressed run lengths of an image's columns", "amodal"),
    ("tracks/object", "uint8", "point", "id", "-", "id of the object that the point is on; 0 = table", "tracks"),
    ("tracks/query", "float32", "point 3", "frame, pixel", "image", "frame, y and x where the point was chosen, visible there", "tracks"),
    ("tracks/query_view", "uint16", "point", "view", "-", "view in which it was chosen", "tracks"),
    ("tracks/position_2d", "float32", "view point frame 2", "pixel", "image", "x and y in every frame, pixel centres at +0.5; zeros behind the camera", "tracks"),
    ("tracks/occluded", "uint8", "view point frame", "bool", "image", "1 where the point is hidden or outside the image", "tracks"),
    ("tracks/position_3d", "float32", "point frame 3", "m", "world", "position in every frame", "tracks"),
]  # fmt: skip

_LENGTHS = {"3": 3, "4": 4, "8": 8, "2": 2, "channel": 3}
"""Lengths of axes that are the same in every dataset."""
_MOST = {"object": 255, "light": 255, "byte": 32, "point": 100_000}
"""Greatest lengths of axes whose lengths a spec does not say."""

FIELDS: dict[str, Field] = {
    name: Field(name, dtype, tuple(axes.split()), *facts) for name, dtype, axes, *facts in _FIELDS
}


class SchemaError(ValueError):
    """A record that is not of this format."""


def validate(record: Mapping[str, np.ndarray], groups: tuple[str, ...]) -> None:
    """Check names, dtypes and axes of one scene's arrays.

    Raises:
        SchemaError: names the field and what is wrong with it.
    """
    wanted = {name for name, field in FIELDS.items() if field.group in groups}
    if missing := sorted(wanted - set(record)):
        raise SchemaError(f"Fields are missing: {', '.join(missing)}.")
    lengths: dict[str, int] = {}
    for name, array in record.items():
        if name not in FIELDS:
            raise SchemaError(f"Field {name} is not part of format {FORMAT_VERSION}.")
        stored = np.asarray(array)
        check_field(FIELDS[name], stored.dtype, stored.shape, lengths)


def check_field(field: Field, dtype: np.dtype, shape: tuple[int, ...], lengths: dict[str, int]) -> None:
    """Check type and axes of one scene's array; lengths of axes that are not known yet are added to `lengths`.

    Raises:
        SchemaError: names the field and what is wrong with it.
    """
    if field.dtype == "S":
        if dtype.kind != "S":
            raise SchemaError(f"Field {field.name} has dtype {dtype}, expected fixed-length bytes.")
    elif dtype != np.dtype(field.dtype):
        raise SchemaError(f"Field {field.name} has dtype {dtype}, expected {field.dtype}.")
    if len(shape) != len(field.axes):
        raise SchemaError(f"Field {field.name} has shape {shape}, expected axes {' '.join(field.axes)}.")
    for axis, length in zip(field.axes, shape, strict=True):
        base, extra = ("object", 1) if axis == "object+1" else (axis, 0)
        expected = _LENGTHS[base] if base in _LENGTHS else lengths.setdefault(base, length - extra)
        if expected + extra != length:
            raise SchemaError(f"Field {field.name}: axis {axis} has length {length}, expected {expected + extra}.")
        if expected > _MOST.get(base, expected):
            raise SchemaError(f"Field {field.name}: axis {axis} has length {length}, expected at most {_MOST[base]}.")


def scene_hash(record: Mapping[str, np.ndarray]) -> str:
    """SHA-256 over names, dtypes, shapes and bytes of a scene's arrays, in the order of their names."""
    digest = hashlib.sha256()
    for name in sorted(record):
        digest.update(array_hash(name, record[name]).encode())
    return digest.hexdigest()


def array_hash(name: str, array: np.ndarray) -> str:
    """SHA-256 of one named array; text counts without its padding, so that shards may pad it differently."""
    array = np.asarray(array)
    if array.dtype.kind == "S":
        payload, kind = b"\0".join(bytes(text) for text in array.ravel()), "S"
    else:
        payload, kind = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes(), array.dtype.name
    return hashlib.sha256(f"{name}|{kind}|{array.shape}|".encode() + payload).hexdigest()


def encode_depth(depth: np.ndarray) -> np.ndarray:
    """Convert metres to stored units.

    Raises:
        UsageError: a depth does not fit the format (negative, beyond `MAX_DEPTH`, or not finite).
    """
    if not np.all((depth >= 0) & (depth <= MAX_DEPTH)):
        raise UsageError(
            f"Depths from {np.min(depth):.3f} to {np.max(depth):.3f} m do not fit the format, which holds 0 to "
            f"{MAX_DEPTH:.3f} m; move the camera closer or make the table smaller."
        )
    return np.rint(depth.astype(np.float64) / DEPTH_SCALE).astype(np.uint16)


def decode_depth(stored: np.ndarray) -> np.ndarray:
    """Convert stored units to metres, float32."""
    return (stored * np.float64(DEPTH_SCALE)).astype(np.float32)


def effect_mask(effects: np.ndarray, name: int) -> np.ndarray:
    """Mask of the pixels that the object with id `name` affects, from `edits/remove/effects`."""
    byte, bit = divmod(name - 1, 8)
    return (effects[..., byte] >> bit & 1).astype(bool)
