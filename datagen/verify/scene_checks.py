"""All checks of one scene."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np

from datagen.config import Physics, Sensor
from datagen.errors import DatagenError
from datagen.shapes.shape import MeshSource
from datagen.verify.arrays import check_counts, check_description, check_schema, check_sensor
from datagen.verify.bodies import check_boxes, check_overlap, check_poses
from datagen.verify.cameras import check_paths
from datagen.verify.edits import check_edit, check_effects
from datagen.verify.pixels import check_order, check_surfaces, check_table
from datagen.verify.scene_case import DEFAULT, OPENGL, PRECISION, Allowed, Case, Finding, make_case
from datagen.verify.signals import check_amodal, check_coordinates, check_flow, check_normals, check_tracks
from datagen.verify.views import check_views

Check = Callable[[Case], Iterator[Finding]]

CHECKS: dict[str, tuple[Check, ...]] = {
    "simulation": (check_description, check_poses, check_overlap),
    "moving_camera": (check_paths,),
    "pixels": (check_counts, check_boxes, check_surfaces, check_table, check_order, check_views),
    "sensor": (check_sensor,),
    "remove": (partial(check_edit, kind="remove"), check_effects),
    "move": (partial(check_edit, kind="move"),),
    "add": (partial(check_edit, kind="add"),),
    "flow": (check_flow,),
    "tracks": (check_tracks,),
    "normals": (check_normals,),
    "coordinates": (check_coordinates,),
    "amodal": (check_amodal,),
}
"""Checks by the group of fields that they need."""


def verify_record(
    record: Mapping[str, np.ndarray],
    groups: tuple[str, ...],
    physics: Physics = DEFAULT.physics,
    *,
    sensor: Sensor = DEFAULT.sensor,
    renderer: str = "raster",
    meshes: MeshSource | None = None,
) -> list[Finding]:
    """All contradictions within one scene's arrays, which must have the fields of `groups`, see `schema.Field.group`.

    The recipe's physics limits how deep contacts may be, its sensor determines the noise of sensor depth, and the
    renderer determines how exact depth and ids can be. `meshes` holds the geometry of meshes.
    """
    if findings := list(check_schema(record, groups)):
        return findings
    try:
        # An unknown renderer is taken for one that is no more exact than OpenGL.
        case = make_case(record, Allowed(physics, sensor, PRECISION.get(renderer, OPENGL)), meshes)
    except (ValueError, KeyError, TypeError, IndexError, DatagenError) as error:
        return [Finding("description", f"cannot be built: {type(error).__name__} {error}")]
    if case.count != record["objects/count"]:
        message = f"objects/count is {record['objects/count']}, scene/description has {case.count} bodies"
        return [Finding("description", message)]
    return [finding for group in groups for check in CHECKS[group] for finding in _findings(check, case)]


def _findings(check: Check, case: Case) -> list[Finding]:
    # Damaged numbers, such as a singular camera matrix, must not hide what else is wrong with a dataset.
    try:
        return list(check(case))
    except (ValueError, IndexError, ArithmeticError) as error:
        name = check.func.__name__ if isinstance(check, partial) else check.__name__
        return [Finding(name, f"cannot be checked: {type(error).__name__} {error}")]
