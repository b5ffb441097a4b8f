"""Poses, boxes and symmetries of BOP, from exports of generated scenes."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmark.clips import has_true_poses
from datagen.errors import CorruptFile, UsageError
from datagen.formats.import_request import Request
from datagen.formats.importers.bop_models import Models
from datagen.formats.importers.convert import WITH_MODELS, WITH_POSES
from datagen.formats.importers.write import Report, import_dataset
from datagen.storage.reader import Dataset
from datagen.verify.dataset import find
from tests.datagen.formats.conftest import Export
from tests.worlds import rendered
from tests.worlds.meshes import write_ply


def take(source: Path, out: Path, **changes: object) -> Report:
    return import_dataset(Request(format="bop", source=source, out=out, **changes))


@pytest.mark.parametrize(("dataset", "grouping"), [("clips", "clip"), ("stills", "views")])
def test_poses_boxes_and_symmetries_come_back(
    dataset: str, grouping: str, exported: Export, tmp_path: Path, request: pytest.FixtureRequest
):
    source: Path = request.getfixturevalue(dataset)
    take(exported(source, "bop"), tmp_path / "back", group=grouping)
    scenes, back = (Dataset(folder).split("train") for folder in (source, tmp_path / "back"))
    assert has_true_poses(back)
    assert find(tmp_path / "back") == []
    for original, record in zip(scenes, back, strict=True):
        count = int(original["objects/count"])
        assert np.array_equal(record["segmentation"], original["segmentation"])
        assert np.array_equal(record["objects/symmetry"][:count], original["objects/symmetry"][:count])
        for name in WITH_POSES:
            shared = np.abs(record[name][:, :count]), np.abs(original[name][:, :count])
            np.testing.assert_allclose(*shared, atol=1e-5)
        # The mesh of a round shape is up to 0.08 mm from its surface.
        for name in ("objects/size", "objects/minimum_box_size"):
            np.testing.assert_allclose(record[name][:count], original[name][:count], atol=2e-4)
        np.testing.assert_allclose(np.mean(record["boxes/box_3d"], axis=2)[:, :count],
                                   np.mean(original["boxes/box_3d"], axis=2)[:, :count], atol=2e-4)  # fmt: skip


def test_without_models_poses_are_kept_and_boxes_unknown(stills: Path, exported: Export, tmp_path: Path):
    folder = exported(stills, "bop")
    shutil.rmtree(folder / "models")
    fields = take(folder, tmp_path / "back").spec["fields"]["train"]
    assert set(WITH_POSES) <= set(fields)
    assert not set(WITH_MODELS) & set(fields)


def test_objects_that_move_between_views_and_wrong_rotations_are_refused(clips: Path, exported: Export, tmp_path: Path):
    folder = exported(clips, "bop") / "train" / "000000"
    truth = json.loads((folder / "scene_gt.json").read_text())
    wrong = json.loads(json.dumps(truth))
    wrong["2"][1]["cam_R_m2c"][0] += 0.1
    truth["2"][1]["cam_t_m2c"][0] += 30
    cases = ((truth, r"differ by 0\.03\d* m between the views"), (wrong, "image 2: cam_R_m2c is no rotation"))
    for values, message in cases:
        (folder / "scene_gt.json").write_text(json.dumps(values))
        with pytest.raises(UsageError, match=message):
            take(folder, tmp_path / "back", group="views")
    assert not (tmp_path / "back").exists()


def test_a_wrong_pose_is_found_by_verify(stills: Path, exported: Export, tmp_path: Path):
    take(exported(stills, "bop"), tmp_path / "back")
    rendered.change_scene(tmp_path / "back", "train", 0, lambda record: record["poses/position"].__iadd__(0.2))
    messages = [finding.message for finding in find(tmp_path / "back")]
    assert any("not its minimum box" in message for message in messages)
    assert any("outside of its box" in message for message in messages)


def test_a_missing_or_flat_model_is_named(tmp_path: Path):
    (tmp_path / "models_info.json").write_text("{}")
    with pytest.raises(UsageError, match=r"obj_000001\.ply is missing"):
        Models(tmp_path).model(1)
    write_ply(tmp_path / "obj_000001.ply", np.eye(3), np.array([[0, 1, 2]]))
    with pytest.raises(CorruptFile, match=r"obj_000001\.ply is flat"):
        Models(tmp_path).model(1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"1": {"symmetries_discrete": [[1, 2]]}}, "expected 16 numbers"),
        ({"1": {"symmetries_continuous": [[0, 0, 1]]}}, "expected an object"),
        ({"1": {"symmetries_continuous": [{"axis": [0, 0, 0]}]}}, "without length"),
        ({"1": {"symmetries_continuous": 3}}, "expected a list"),
    ],
)
def test_damaged_symmetries_are_named(change: dict[str, object], message: str, tmp_path: Path):
    (tmp_path / "models_info.json").write_text(json.dumps(change))
    with pytest.raises(CorruptFile, match=f"models_info.json: model 1.*{message}"):
        Models(tmp_path).symmetry(1)
