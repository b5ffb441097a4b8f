import re
from collections.abc import Callable

import numpy as np
import pytest

from datagen.schema import EDITS, SceneRecord
from datagen.verify import verify_record
from tests.worlds import rendered

GROUPS = (*rendered.GROUPS, *EDITS)
RECORD = rendered.record(rendered.scene(views=2), edits=EDITS)


def find(change: Callable[[SceneRecord], None] = lambda record: None) -> list[str]:
    record = {name: array.copy() for name, array in RECORD.items()}
    change(record)
    return [f"{finding.check}: {finding.message}" for finding in verify_record(record, GROUPS)]


def test_rendered_edits_are_proved():
    assert find() == []


def set_depth(record: SceneRecord) -> None:
    place = "edits/move/segmentation", int(record["edits/move/object"])
    record["edits/move/depth"][record[place[0]] == place[1]] += 10


def set_transform(record: SceneRecord) -> None:
    record["edits/add/transform"][0, 3] += 0.005


def leave_the_table(record: SceneRecord) -> None:
    record["edits/move/transform"][2, 3] += 0.001


def not_removed(record: SceneRecord) -> None:
    for name in ("rgb", "depth", "segmentation"):
        record[f"edits/remove/{name}"] = record[name]


def no_such_object(record: SceneRecord) -> None:
    record["edits/remove/object"] = np.asarray(9, np.uint8)


def secretly_edited(record: SceneRecord) -> None:
    record["edits/add/object"] = np.asarray(0, np.uint8)


def effects_on_itself(record: SceneRecord) -> None:
    record["edits/remove/effects"][record["segmentation"] == 1] |= 1


def effects_of_nobody(record: SceneRecord) -> None:
    record["edits/remove/effects"][0, 0, 0, 0] |= 8


def effects_without_change(record: SceneRecord) -> None:
    record["edits/remove/effects"][:, :, 0, 0] |= np.uint8(1 << int(record["edits/remove/object"]) - 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_depth, "surface: move: "),
        (set_transform, "surface: add: "),
        (leave_the_table, "edits: move: the transform leaves the table"),
        (not_removed, "edits: remove: .* ids of no object"),
        (no_such_object, "edits: remove: there is no object 9"),
        (secretly_edited, "edits: add: nothing is edited, but"),
        (effects_on_itself, "edits: remove: object 1 has effects on itself"),
        (effects_of_nobody, "edits: remove: effects of objects that are not there"),
        (effects_without_change, "edits: remove: effects of object . where its removal changes nothing"),
    ],
)
def test_a_wrong_edit_is_found(change: Callable[[SceneRecord], None], message: str):
    found = find(change)
    assert found
    assert any(re.match(message, line) for line in found), found
