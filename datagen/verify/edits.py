"""Check edited scenes against the geometry of their edits, with the checks of the original scene."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from datagen.schema import LEAST_EFFECT, EditKind, effect_mask
from datagen.verify.bodies import check_exact_overlap
from datagen.verify.pixels import check_order, check_surfaces, check_table
from datagen.verify.scene_case import Case, Finding
from datagen.verify.views import check_views

RIGID = 1e-9
"""Allowed deviation of a stored transform from a rotation about the vertical and a translation along the table."""

_IMAGES = ("rgb", "depth", "segmentation")
_CAMERAS = ("camera/K", "camera/world_from_camera", "camera/world_from_camera_of_frame")


def check_edit(case: Case, kind: EditKind) -> Iterator[Finding]:
    """Check that images of an edited scene show the scene that its edit describes."""
    row = int(case.record[f"edits/{kind}/object"]) - 1
    if row >= case.count:
        yield Finding("edits", f"{kind}: there is no object {row + 1}")
    elif row < 0:
        if any(np.any(case.record[f"edits/{kind}/{name}"] != case.record[name]) for name in _IMAGES):
            yield Finding("edits", f"{kind}: nothing is edited, but the images are not the scene's own")
    else:
        transform = case.record.get(f"edits/{kind}/transform", np.eye(4))
        if not _is_along_the_table(transform):
            yield Finding("edits", f"{kind}: the transform leaves the table or is not rigid")
        edited, strange = edited_case(case, kind, row, transform)
        if np.any(strange):
            yield Finding("edits", f"{kind}: {np.sum(strange)} pixels have ids of no object in the scene")
            return
        for check in (check_surfaces, check_table, check_order, check_views):
            yield from (replace(found, message=f"{kind}: {found.message}") for found in check(edited))
        if kind != "remove":
            yield from (replace(found, message=f"{kind}: {found.message}") for found in check_exact_overlap(edited))


def check_effects(case: Case) -> Iterator[Finding]:
    """Check that no object has effects on its own pixels, and that those of the removed one change the picture."""
    effects = case.record["edits/remove/effects"]
    if np.any(np.unpackbits(effects, axis=-1, bitorder="little")[..., case.count :]):
        yield Finding("edits", "remove: effects of objects that are not there")
    for row in range(case.count):
        if np.any(effect_mask(effects, row + 1) & (case.record["segmentation"] == row + 1)):
            yield Finding("edits", f"remove: object {row + 1} has effects on itself")
    if (name := int(case.record["edits/remove/object"])) and not case.allowed.precision.path_traced:
        change = np.abs(case.record["rgb"].astype(int) - case.record["edits/remove/rgb"]).sum(axis=-1)
        if np.any(effect_mask(effects, name) & (change < LEAST_EFFECT)):
            yield Finding("edits", f"remove: effects of object {name} where its removal changes nothing")


def edited_case(
    case: Case, kind: EditKind, row: int, transform: Float[np.ndarray, "4 4"]
) -> tuple[Case, Bool[np.ndarray, "frame view height width"]]:
    """The edited scene as a case of its own, and the pixels whose ids it does not know."""
    rows = [other for other in range(case.count) if kind != "remove" or other != row] + [row] * (kind == "add")
    poses = case.world_from_object[:, rows].copy()
    if kind != "remove":
        place = row if kind == "move" else case.count
        poses[:, place] = transform @ poses[:, place]
    places = np.full(256, 255, np.uint8)
    places[0] = 0
    for place, other in enumerate(rows, 1):
        places[place if place > case.count else other + 1] = place
    segmentation = places[case.record[f"edits/{kind}/segmentation"]]
    images = {"depth": case.record[f"edits/{kind}/depth"], "segmentation": segmentation}
    record = {**{name: case.record[name] for name in _CAMERAS if name in case.record}, **images}
    scene = replace(case.scene, bodies=tuple(case.scene.bodies[other] for other in rows))
    shapes = [case.shapes[other] for other in rows]
    return Case(record, scene, shapes, poses, case.allowed), segmentation == 255


def _is_along_the_table(transform: Float[np.ndarray, "4 4"]) -> bool:
    cos, sin = transform[0, 0], transform[1, 0]
    x, y = transform[:2, 3]
    wanted = np.array([[cos, -sin, 0, x], [sin, cos, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
    return bool(np.max(np.abs(transform - wanted)) < RIGID and abs(cos**2 + sin**2 - 1) < RIGID)
