"""Every format, read from a small source in exactly its layout: points of all pixels lie on the surfaces they show."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from imageio.v3 import imread

from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.formats.import_request import ReadOptions, Request
from datagen.formats.importers import rgbd
from datagen.formats.importers.write import FPS, Report, import_dataset
from datagen.storage.reader import Dataset
from datagen.verify.dataset import find
from tests.worlds import recordings
from tests.worlds.recordings import CAMERAS, SIZE, errors, shoot, write_json, write_rgbd

MILLIMETRE = 1e-3


def take(source: Path, out: Path, **changes: object) -> Report:
    reading = {name: changes.pop(name) for name in list(changes) if name in ReadOptions.__dataclass_fields__}
    return import_dataset(Request(source=source, out=out, reading=ReadOptions(**reading), **changes))


def multishapenet(folder: Path) -> Path:
    return recordings.write_obsurf(folder, multishapenet=True)


def rgbd_with_poses(folder: Path) -> Path:
    shot = shoot()
    return write_rgbd(folder, [shot, shot], world_from_camera=shot.pose.tolist())


def rgbd_with_two_lenses(folder: Path) -> Path:
    """The second image shows another part of what the camera sees, which moves its principal point."""
    shot, k = shoot(), [shoot().k.copy() for _ in range(2)]
    folder = write_rgbd(folder, [shot, shot], world_from_camera=shot.pose.tolist(), pixel_center=0.5)
    for name, array in (("rgb", shot.rgb), ("depth", recordings.units(shot.depth, 1e-4)), ("masks", shot.ids)):
        recordings.save(folder / name / "1.png", np.roll(array, (-3, -5), (0, 1)))
        for path in (folder / name).glob("*.png"):
            recordings.save(path, imread(path)[:-3, :-5])
    k[1][:2, 2] -= [5, 3]
    write_json(folder / "camera.json", {**json.loads((folder / "camera.json").read_text()), "K": np.array(k).tolist()})
    return folder


def rgbd_euclidean_views(folder: Path) -> Path:
    for view, position in enumerate(CAMERAS):
        shot = shoot(position)
        place = write_rgbd(folder / f"view{view}", [shot], depth_type="euclidean", pixel_center=0)
        recordings.save(place / "depth/0.png", recordings.units(shot.distance, 1e-4))
        np.savetxt(place / "world_from_camera.txt", shot.pose)
    return folder


def bop_test(folder: Path) -> Path:
    recordings.write_bop(folder / "test_primesense" / "000001")
    return folder


CASES: dict[str, tuple[str, Callable[[Path], Path], dict[str, object], dict[str, int], tuple[int, int]]] = {
    "rgbd": ("rgbd", rgbd_with_poses, {"split": "test"}, {"test": 1}, (2, 1)),
    "rgbd views": ("rgbd", rgbd_euclidean_views, {"split": "test"}, {"test": 1}, (1, 3)),
    "clevr3d": ("obsurf", recordings.write_obsurf, {}, {"train": 2}, (1, 3)),
    "multishapenet": ("obsurf", multishapenet, {}, {"train": 2}, (1, 3)),
    "obpose": ("obpose", recordings.write_authors, {}, {"train": 2, "test": 1}, (3, 1)),
    "bop": ("bop", bop_test, {}, {"test": 3}, (1, 1)),
    "bop views": ("bop", bop_test, {"group": "views"}, {"test": 1}, (1, 3)),
    "octscenes": ("octscenes", recordings.write_octscenes, {"views": 2}, {"train": 1, "test": 1}, (1, 2)),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_points_lie_on_the_surfaces_that_their_pixels_show(case, tmp_path: Path):
    name, write, changes, splits, (frames, views) = case
    take(write(tmp_path / "source"), tmp_path / "out", format=name, **changes)
    dataset = Dataset(tmp_path / "out")
    assert {split: count for split, count in dataset.splits.items() if count} == splits
    assert find(tmp_path / "out") == []
    labelled = [split for split in splits if dataset.split(split).has("segmentation")]
    record = dataset.split(labelled[-1])[0]
    assert record["depth"].shape == (frames, views, SIZE[1], SIZE[0])
    assert max(errors(record).values()) < MILLIMETRE
    assert np.array_equal(record["segmentation"][0, 0], shoot().ids)
    assert np.array_equal(record["rgb"], recordings.COLOURS[record["segmentation"]])


def test_a_bop_scene_without_its_cameras_is_not_left_out_silently(tmp_path: Path):
    source = bop_test(tmp_path / "bop")
    recordings.write_bop(source / "test_primesense" / "000002")
    (source / "test_primesense/000002/scene_camera.json").unlink()
    with pytest.raises(DatagenError, match=r"000002/scene_camera\.json"):
        take(source, tmp_path / "out", format="bop")
    assert not (tmp_path / "out").exists()


def test_each_image_may_have_its_own_lens_except_in_a_clip(tmp_path: Path):
    source = rgbd_with_two_lenses(tmp_path / "source")
    for group in ("stills", "views"):
        take(source, tmp_path / group, format="rgbd", group=group, split="test")
        assert all(max(errors(scene).values()) < MILLIMETRE for scene in Dataset(tmp_path / group).split("test"))
    with pytest.raises(UsageError, match=r"the camera matrix changes in the clip.*--group stills"):
        take(source, tmp_path / "clip", format="rgbd")
    assert not (tmp_path / "clip").exists()


def test_lenses_belong_to_the_images_that_were_kept(tmp_path: Path):
    """Of three images, named by their times, the second has no depth; each has its own lens."""
    source = rgbd_with_two_lenses(tmp_path / "source")
    for folder in ("rgb", "depth", "masks"):
        for number, time in ((0, 0), (1, 2)):
            (source / folder / f"{number}.png").rename(source / folder / f"{1.3e9 + time:.1f}.png")
    (source / "rgb" / "1300000001.0.png").write_bytes((source / "rgb" / "1300000000.0.png").read_bytes())
    (source / "masks" / "1300000001.0.png").write_bytes((source / "masks" / "1300000000.0.png").read_bytes())
    camera = json.loads((source / "camera.json").read_text())
    first, last = camera["K"]
    write_json(source / "camera.json", {**camera, "K": [first, [[40, 0, 20], [0, 40, 15], [0, 0, 1]], last]})
    take(source, tmp_path / "out", format="rgbd", group="stills", split="test")
    scenes = list(Dataset(tmp_path / "out").split("test"))
    assert len(scenes) == 2
    assert all(max(errors(scene).values()) < MILLIMETRE for scene in scenes)


def test_views_are_in_the_order_of_their_numbers(tmp_path: Path):
    for number in (0, 1, 2, 10):
        write_rgbd(tmp_path / "source" / f"view{number}", [shoot()])
    (_, _, views), *others = rgbd._recordings(tmp_path / "source")
    assert not others
    assert [view.place.name for view in views] == ["view0", "view1", "view2", "view10"]


def test_names_of_objects_are_kept(tmp_path: Path):
    take(bop_test(tmp_path / "bop"), tmp_path / "a", format="bop")
    take(recordings.write_authors(tmp_path / "npy"), tmp_path / "b", format="obpose")
    rgbd = write_rgbd(tmp_path / "rgbd", [shoot()])
    write_json(rgbd / "objects.json", [{"id": 2, "category": "Schüssel"}])
    take(rgbd, tmp_path / "c", format="rgbd", split="test")
    names = [Dataset(tmp_path / folder).split("test")[0]["objects/category"].tolist() for folder in "abc"]
    assert names == [[b"obj_000002", b"obj_000007"], [b"mug", b"bowl"], [b"", b"Sch?ssel"]]


def test_frames_per_second_are_those_of_the_user_or_of_the_recording(tmp_path: Path):
    source = write_rgbd(tmp_path / "source", [shoot(), shoot()], fps=30)
    for name, changes, fps in (("a", {}, 30), ("b", {"fps": 5.0}, 5)):
        assert take(source, tmp_path / name, format="rgbd", **changes).spec["recipe"]["fps"] == fps
    unknown = write_rgbd(tmp_path / "unknown", [shoot(), shoot()])
    assert take(unknown, tmp_path / "c", format="rgbd").spec["recipe"]["fps"] == FPS


def test_scenes_with_too_many_objects_are_left_out(tmp_path: Path):
    source = recordings.write_obsurf(tmp_path / "source")
    arrays = dict(np.load(source / "metadata.npz"))
    arrays["shape"][1] = 1  # ten objects
    np.savez(source / "metadata.npz", **arrays)
    report = take(source, tmp_path / "out", format="obsurf")
    assert report.spec["splits"]["train"] == 1
    assert "1 scene left out with more than 6 objects" in " ".join(report.notes)
    assert take(source, tmp_path / "all", format="obsurf", most_objects=10).spec["splits"]["train"] == 2


def test_published_splits_go_by_the_scene_number(tmp_path: Path):
    source = recordings.write_obsurf(tmp_path / "source", scenes=(69_999, 70_000, 70_500, 85_000))
    report = take(source, tmp_path / "out", format="obsurf")
    assert report.spec["splits"] == {"train": 1, "val": 1, "test": 1}


def test_views_of_the_authors_have_their_own_cameras(tmp_path: Path):
    source = tmp_path / "train"
    source.mkdir()
    for number, position in enumerate(CAMERAS):
        shot = shoot(position)
        frame = {**recordings.authors_frame(shot), "misc": recordings.authors_camera(shot)}
        np.save(source / f"{number}.npy", np.array(frame, object), allow_pickle=True)
    take(tmp_path, tmp_path / "out", format="obpose")
    scenes = Dataset(tmp_path / "out").split("train")
    assert [max(errors(scene).values()) < MILLIMETRE for scene in scenes] == [True] * 3


def test_a_recording_without_poses_stands_on_its_table(tmp_path: Path):
    report = take(write_rgbd(tmp_path / "a", [shoot()]), tmp_path / "out", format="rgbd")
    record = Dataset(tmp_path / "out").split("train")[0]
    assert report.measured[0].estimated_world
    assert report.spec["import"]["world"] == "table"
    assert errors(record)[0] < 2 * MILLIMETRE  # the table is at z = 0
    camera = record["camera/world_from_camera"][0, :3, 3]
    assert camera[2] == pytest.approx(CAMERAS[0][2], abs=0.005)
    assert camera[0] > 0  # x points to the camera
    assert camera[1] == pytest.approx(0, abs=1e-3)


def test_given_poses_can_be_moved_onto_the_table(tmp_path: Path):
    shots = [shoot(position) for position in CAMERAS]
    lifted = [shot.pose + np.eye(4)[2][:, None] * np.array([0, 0, 0, 1.0]) for shot in shots]
    source = write_rgbd(tmp_path / "a", shots, world_from_camera=[pose.tolist() for pose in lifted])
    take(source, tmp_path / "given", format="rgbd", group="views")
    take(source, tmp_path / "table", format="rgbd", group="views", world="table")
    given, table = (Dataset(tmp_path / name).split("train")[0] for name in ("given", "table"))
    worlds = [Dataset(tmp_path / name).spec["import"]["world"] for name in ("given", "table")]
    assert worlds == ["given", "table"]
    assert errors(given)[0] == pytest.approx(1.0, abs=0.01)
    assert errors(table)[0] < 0.005
    relative = [
        np.linalg.inv(poses[0]) @ poses[1]
        for poses in (given["camera/world_from_camera"], table["camera/world_from_camera"])
    ]
    assert np.allclose(*relative)


def break_rgbd(folder: Path, change: Callable[[Path], object]) -> Path:
    source = write_rgbd(folder, [shoot(), shoot()])
    change(source)
    return source


def clip_of_moving_camera(folder: Path) -> None:
    poses = [shoot(position).pose.tolist() for position in CAMERAS[:2]]
    write_rgbd(folder, [shoot(position) for position in CAMERAS[:2]], world_from_camera=poses)


def edit_camera(**changes: object) -> Callable[[Path], object]:
    values = recordings.camera_json(shoot())
    return lambda folder: write_json(folder / "camera.json", {**values, **changes})


EMPTY = np.zeros((36, 48), np.uint16)
SMALL = shoot(size=(40, 30))
BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing depth": (lambda folder: (folder / "depth/1.png").unlink(), "1 depth images in .*; 1.png has none"),
    "missing mask": (lambda folder: (folder / "masks/1.png").unlink(), "2 colour images but 1 masks"),
    "a gap": (lambda folder: (folder / "depth/1.png").rename(folder / "depth/2.png"), "their numbers differ"),
    "no depth": (lambda folder: (folder / "depth").rename(folder / "other"), "colour but no depth"),
    "no camera": (lambda folder: (folder / "camera.json").unlink(), "camera.json is missing"),
    "mixed sizes": (lambda folder: recordings.save(folder / "rgb/1.png", SMALL.rgb), "rgb/1.png is 40x30"),
    "unaligned mask": (lambda folder: recordings.save(folder / "masks/0.png", SMALL.ids), "masks/0.png is 40x30"),
    "damaged image": (lambda folder: (folder / "rgb/0.png").write_bytes(b"\x89PNG"), "rgb/0.png is damaged"),
    "cut image": (
        lambda folder: (folder / "depth/0.png").write_bytes((folder / "depth/0.png").read_bytes()[:200]),
        "depth/0.png is damaged",
    ),
    "colour mask": (lambda folder: recordings.save(folder / "masks/0.png", shoot().rgb), "no mask: it has mode RGB"),
    "millimetres as metres": (edit_camera(depth_scale=1), r"With --depth-scale 0.0001 it would be 0.\d+ m"),
    "no unit": (edit_camera(depth_scale=0), "depth_scale is 0"),
    "no focal length": (edit_camera(fx="wide"), "fx, fy, cx, cy is"),
    "other size": (edit_camera(fx=5e5), "cannot be those of images of 48x36"),
    "transposed": (edit_camera(K=shoot().k.T.tolist()), "Transpose it"),
    "too many lenses": (edit_camera(K=[shoot().k.tolist()] * 3), "K holds 3 matrices for 2 images"),
    "infinite": (lambda folder: (folder / "camera.json").write_text('{"fx": NaN}'), "NaN"),
    "no object": (lambda folder: (folder / "camera.json").write_text("[]"), "expected an object"),
    "mirrored pose": (edit_camera(world_from_camera=np.diag([1, 1, -1, 1.0]).tolist()), "no rigid pose"),
    "too few poses": (edit_camera(world_from_camera=[np.eye(4).tolist()]), "no pose for image 1"),
    "moving camera": (clip_of_moving_camera, "the camera moves by"),
    "empty depth": (lambda folder: recordings.save(folder / "depth/0.png", EMPTY), "has no depth"),
    "names": (lambda folder: write_json(folder / "objects.json", {"1": "mug"}), "expected a list of objects"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), BROKEN.values(), ids=BROKEN)
def test_a_bad_recording_is_named_and_nothing_is_written(change, message: str, tmp_path: Path):
    source = break_rgbd(tmp_path / "source", change)
    with pytest.raises(DatagenError, match=message):
        take(source, tmp_path / "out", format="rgbd")
    assert [path.name for path in tmp_path.iterdir()] == ["source"]


def test_a_file_that_the_system_refuses_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    source = write_rgbd(tmp_path / "source", [shoot()])

    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(rgbd, "read_colour", refuse)
    with pytest.raises(UsageError, match=r"rgb/0\.png cannot be read: Permission denied"):
        take(source, tmp_path / "out", format="rgbd")


def test_depth_in_floats_is_metres_unless_said_otherwise(tmp_path: Path):
    shot = shoot()
    source = write_rgbd(tmp_path / "source", [shot], world_from_camera=shot.pose.tolist())
    (source / "depth/0.png").unlink()
    for number, unit in enumerate((1.0, 0.001)):
        np.save(source / "depth/0.npy", shot.depth / unit)
        if number:
            with pytest.raises(UsageError, match=r"With --depth-scale 0\.001 it would be 0\.\d+ m"):
                take(source, tmp_path / "fails", format="rgbd")
        take(source, tmp_path / f"{number}", format="rgbd", depth_scale=unit if number else None)
        assert max(errors(Dataset(tmp_path / f"{number}").split("train")[0]).values()) < MILLIMETRE


def test_other_bad_sources_are_named(tmp_path: Path):
    for name in ("rgbd", "obsurf", "obpose", "bop", "octscenes"):
        for source in (tmp_path, tmp_path / "nowhere"):
            with pytest.raises(DatagenError, match=re.escape(str(source))):
                take(source, tmp_path / "out", format=name)
    bop = recordings.write_bop(tmp_path / "000000")
    cases = {
        "scene_camera.json": ({"../../secret": {}}, "has the image '../../secret'"),
        "scene_gt.json": ({"0": [{"obj_id": "../x"}]}, "has obj_id"),
    }
    for file, (values, message) in cases.items():
        old = (bop / file).read_text()
        write_json(bop / file, values)
        with pytest.raises(DatagenError, match=message):
            take(bop, tmp_path / "out", format="bop")
        (bop / file).write_text(old)
    (bop / "mask_visib/000001_000001.png").unlink()
    with pytest.raises(DatagenError, match=r"000001_000001\.png is missing"):
        take(bop, tmp_path / "out", format="bop")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("camera_pos", "message"),
    [
        (np.full((2, 3, 3), np.nan), "camera_pos of scene 0, view 0 holds no rigid pose"),
        (np.full((2, 3, 3), "far"), "camera_pos.*numbers"),
    ],
)
def test_positions_that_are_no_numbers_are_refused(camera_pos: np.ndarray, message: str, tmp_path: Path):
    source = recordings.write_obsurf(tmp_path / "source")
    np.savez(source / "metadata.npz", shape=np.ones((2, 2), np.int64), camera_pos=camera_pos)
    with pytest.raises(DatagenError, match=message):
        take(source, tmp_path / "out", format="obsurf")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "damage",
    [
        {"camera_intrinsics": [[1, 2, 3], [4, 5]]},
        {"camera_intrinsics": np.full((3, 3), "a")},
        {"camera_intrinsics": np.full((3, 3), np.nan)},
        {"camera_extrinsics": None},
        {"camera_extrinsics": {}},
    ],
)
def test_authors_cameras_that_are_no_matrices_are_refused(damage: dict[str, Any], tmp_path: Path):
    source = recordings.write_authors(tmp_path / "source")
    camera = {**recordings.authors_camera(shoot()), **damage}
    np.save(source / "camera_info.npy", np.array(camera, object), allow_pickle=True)
    with pytest.raises(CorruptFile, match=r"camera_info\.npy holds no camera; expected camera_intrinsics"):
        take(source, tmp_path / "out", format="obpose")


@pytest.mark.parametrize("name", ["rgb", "depth", "mask_bin"])
def test_authors_frames_that_hold_no_arrays_are_refused(name: str, tmp_path: Path):
    source = recordings.write_authors(tmp_path / "source")
    frame = {**recordings.authors_frame(shoot()), name: "x"}
    np.save(source / "train/0.npy", np.array([frame], object), allow_pickle=True)
    with pytest.raises(CorruptFile, match=r"0\.npy holds no frames; expected dicts with arrays"):
        take(source, tmp_path / "out", format="obpose")


def test_authors_files_with_another_camera_are_refused(tmp_path: Path):
    source = recordings.write_authors(tmp_path / "source")
    other = np.array(recordings.authors_camera(shoot(CAMERAS[1])), object)
    np.save(tmp_path / "other.npy", other, allow_pickle=True)
    with pytest.raises(UsageError, match=r"points \(pcd\) are"):
        take(source, tmp_path / "out", format="obpose", camera=tmp_path / "other.npy")
