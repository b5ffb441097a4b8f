import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from imageio.v3 import imread

from datagen import shapes
from datagen.formats.exporters import bop
from tests.datagen.formats.conftest import Export, source
from tests.worlds import rendered


@pytest.fixture
def scene_folder(stills: Path, exported: Export) -> Path:
    return exported(stills, "bop") / "train" / "000000"


def test_files_follow_the_layout_of_bop_toolkit(scene_folder: Path):
    names = sorted(str(path.relative_to(scene_folder)) for path in scene_folder.rglob("*") if path.is_file())
    images = ["000000", "000001"]
    masks = [f"{kind}/{image}_{row:06d}.png" for kind in ("mask", "mask_visib") for image in images for row in range(3)]
    pictures = [f"{kind}/{image}.png" for kind in ("rgb", "depth") for image in images]
    tables = [f"scene_{kind}.json" for kind in ("camera", "gt", "gt_info")]
    assert names == sorted(masks + pictures + tables)


def test_pixels_at_their_poses_lie_on_the_models(scene_folder: Path):
    """Depth of pixels, whose first centre is at (0, 0) in BOP, turned to the frames of models."""
    cameras, truth = (json.loads((scene_folder / f"scene_{kind}.json").read_text()) for kind in ("camera", "gt"))
    for image in ("0", "1"):
        depth = imread(scene_folder / "depth" / f"{int(image):06d}.png") * cameras[image]["depth_scale"]
        k = np.array(cameras[image]["cam_K"]).reshape(3, 3)
        for row, pose in enumerate(truth[image]):
            visible = imread(scene_folder / "mask_visib" / f"{int(image):06d}_{row:06d}.png") > 0
            y, x = np.nonzero(visible)
            points = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(k).T * depth[y, x][:, None]
            local = (points - pose["cam_t_m2c"]) @ np.array(pose["cam_R_m2c"]).reshape(3, 3)
            distance = shapes.build(rendered.STANDING[row][0]).signed_distance(local / 1000)
            assert np.max(np.abs(distance)) < 2e-4


def test_models_are_the_shapes_in_millimetres(scene_folder: Path):
    for row, (shape, _) in enumerate(rendered.STANDING):
        model = trimesh.load(scene_folder.parents[1] / "models" / f"obj_{row + 1:06d}.ply", process=False)
        assert isinstance(model, trimesh.Trimesh)
        assert np.max(np.abs(shapes.build(shape).signed_distance(model.vertices / 1000))) < 1e-4
        assert np.min(np.sum(model.vertex_normals * model.vertices, axis=1)) > 0
        model.merge_vertices(merge_norm=True)
        assert model.is_watertight
        assert model.volume == pytest.approx(1e9 * shapes.build(shape).volume, rel=0.01)


def test_counts_are_those_of_the_masks(scene_folder: Path, stills: Path):
    information = json.loads((scene_folder / "scene_gt_info.json").read_text())
    scene = source(stills)
    for view in range(2):
        for row, facts in enumerate(information[str(view)]):
            silhouette = imread(scene_folder / "mask" / f"{view:06d}_{row:06d}.png")
            assert set(np.unique(silhouette)) == {0, 255}
            assert facts["px_count_all"] == scene.read("visibility/amodal_pixels")[0, view, row]
            assert facts["px_count_visib"] == scene.read("visibility/visible_pixels")[0, view, row]
            assert facts["visib_fract"] == pytest.approx(scene.read("visibility/visible_fraction")[0, view, row])
            has_depth = scene.depth[0, view] > 0
            assert facts["px_count_valid"] == np.count_nonzero((silhouette > 0) & has_depth)
            visible = scene.segmentation[0, view] == row + 1
            for name, mask in (("bbox_obj", silhouette > 0), ("bbox_visib", visible)):
                rows, columns = np.nonzero(mask)
                sides = np.ptp(columns) + 1, np.ptp(rows) + 1
                assert facts[name] == [columns.min(), rows.min(), *sides]


def test_models_are_listed_with_size_and_symmetry(scene_folder: Path):
    models = json.loads((scene_folder.parents[1] / "models" / "models_info.json").read_text())
    box, cylinder, sphere = models["1"], models["2"], models["3"]
    assert [round(box[f"size_{axis}"], 3) for axis in "xyz"] == [120, 80, 60]
    assert box["diameter"] == pytest.approx(np.linalg.norm([120, 80, 60]), abs=0.01)
    assert len(box["symmetries_discrete"]) == 3
    assert cylinder["symmetries_continuous"] == [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]
    assert len(sphere["symmetries_continuous"]) == 3


def test_equal_shapes_share_a_model(clips: Path, exported: Export):
    folder = exported(clips, "bop")
    assert len(list((folder / "models").glob("*.ply"))) == 3
    second = json.loads((folder / "train" / "000001" / "scene_gt.json").read_text())
    assert [pose["obj_id"] for pose in second["2"]] == [1, 2]


def test_surfaces_that_are_drawn_from_both_sides_are_written_once(tmp_path: Path):
    box = shapes.build(rendered.BOX)
    faces, normals = np.concatenate([box.faces, box.faces[:, ::-1]]), np.concatenate([box.normals, -box.normals])
    bop._write_ply(tmp_path / "closed.ply", box)
    bop._write_ply(tmp_path / "open.ply", dataclasses.replace(box, faces=faces, normals=normals, backs=len(box.faces)))
    assert (tmp_path / "open.ply").read_text() == (tmp_path / "closed.ply").read_text()


@pytest.mark.parametrize(("group", "turns"), [("C1", 0), ("C4", 3), ("D2", 3), ("O", 23)])
def test_finite_groups_are_lists_of_turns(group: str, turns: int):
    assert len(bop.symmetries(group).get("symmetries_discrete", [])) == turns
