import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, EXIT_USAGE
from obpose.commands.segment import main
from obpose.data.clips import ArrayClips
from obpose.data.scene_stats import measure_scene
from obpose.model.build import build_obpose
from obpose.storage.checkpoint import save_model
from obpose.variants import make_config
from tests.worlds.sphere_clips import clip_and_truth

WIDTH, HEIGHT, FRAMES = 32, 24, 2


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames on disk, and an untrained model with their statistics that finds objects everywhere."""
    folder = tmp_path_factory.mktemp("scene")
    clip = clip_and_truth(frames=FRAMES, resolution=(WIDTH, HEIGHT))[0]
    for kind, images in (("rgb", clip.rgb), ("depth", (clip.depth * 1000).round().astype(np.uint16))):
        (folder / kind).mkdir()
        for frame, image in enumerate(images):
            Image.fromarray(image[0]).save(folder / kind / f"{frame}.png")
    np.savetxt(folder / "pose.txt", clip.world_from_camera[0])
    k = clip.k[0]
    (folder / "intrinsics").write_text(",".join(str(k[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2))))
    config = make_config("obpose", **{"model.slots": 2}, **measure_scene(ArrayClips([clip])).changes())
    torch.manual_seed(0)
    model = build_obpose(config)
    with torch.no_grad():
        model.heads.prescope[-1].bias.copy_(torch.tensor([0.0, 5.0]))
    save_model(folder / "model", model.state_dict(), config, {})
    return folder


def run(scene: Path, out: Path, *flags: object, **changes: object) -> int:
    given = {"checkpoint": scene / "model", "rgb": scene / "rgb", "depth": scene / "depth", **changes}
    command = [part for name, value in given.items() for part in (f"--{name}", str(value))]
    camera = ["--intrinsics", (scene / "intrinsics").read_text()]
    return main([*command, *camera, *map(str, flags), "--out", str(out)])


def facts_of(out: Path) -> dict[str, object]:
    return json.loads((out / "objects.json").read_text())


def test_frames_become_labels_overlays_and_poses(scene: Path, tmp_path: Path, capsys):
    assert run(scene, tmp_path, "--camera-pose", scene / "pose.txt") == EXIT_OK
    facts = facts_of(tmp_path)
    assert facts["world"] == "as given with --camera-pose"
    np.testing.assert_allclose(facts["world_from_camera"], np.loadtxt(scene / "pose.txt"), atol=1e-6)
    frames = facts["frames"]
    assert len(frames) == FRAMES
    assert any(frame["objects"] for frame in frames)
    for frame in frames:
        labels = np.asarray(Image.open(tmp_path / frame["labels"]))
        assert labels.shape == (HEIGHT, WIDTH)
        assert {each["label"]: each["pixels"] for each in frame["objects"]} == {
            each["label"]: int(np.sum(labels == each["label"])) for each in frame["objects"]
        }
        assert set(np.unique(labels)) <= {0, *(each["label"] for each in frame["objects"])}
        assert all(each["box_size"] == 0.2 for each in frame["objects"])
    shown = capsys.readouterr().out
    assert str(tmp_path / "objects.json") in shown


def test_without_a_pose_the_world_stands_on_the_table(scene: Path, tmp_path: Path, capsys):
    assert run(scene, tmp_path) == EXIT_OK
    assert "stands on the largest plane" in str(facts_of(tmp_path)["world"])
    assert "stands on the largest plane" in capsys.readouterr().out
    height = np.array(facts_of(tmp_path)["world_from_camera"])[2, 3]
    assert height == pytest.approx(np.loadtxt(scene / "pose.txt")[2, 3], abs=0.01)


def test_another_resolution_is_allowed_and_noted(scene: Path, tmp_path: Path):
    assert run(scene, tmp_path, "--every", 2) == EXIT_OK
    facts = facts_of(tmp_path)
    assert "was not trained for this" in str(facts["resolution"])
    labels = np.asarray(Image.open(tmp_path / facts["frames"][0]["labels"]))
    assert labels.shape == (HEIGHT, WIDTH)
    np.testing.assert_array_equal(labels[::2], labels[1::2])
    np.testing.assert_array_equal(labels[:, ::2], labels[:, 1::2])


def test_a_finer_resolution_gets_a_recommendation(scene: Path, tmp_path: Path):
    clip = clip_and_truth(frames=1, resolution=(3 * WIDTH, 3 * HEIGHT))[0]
    Image.fromarray(clip.rgb[0, 0]).save(tmp_path / "a.png")
    np.save(tmp_path / "d.npy", clip.depth[0, 0])
    k = ",".join(str(3 * float(value)) for value in (scene / "intrinsics").read_text().split(","))
    command = ("--intrinsics", k, "--camera-pose", scene / "pose.txt")
    changes = {"rgb": tmp_path / "a.png", "depth": tmp_path / "d.npy"}
    assert run(scene, tmp_path / "fine", *command, **changes) == EXIT_OK
    assert "--every 3 comes near" in str(facts_of(tmp_path / "fine")["resolution"])
    assert run(scene, tmp_path / "coarse", *command, "--every", 3, **changes) == EXIT_OK
    assert "was not trained" not in str(facts_of(tmp_path / "coarse")["resolution"])
    for every in (2, 6):
        assert run(scene, tmp_path / f"{every}", *command, "--every", every, **changes) == EXIT_OK
        assert "--every 3 comes near" in str(facts_of(tmp_path / f"{every}")["resolution"])


def test_a_wrong_unit_of_depth_is_suspected(scene: Path, tmp_path: Path):
    assert run(scene, tmp_path / "out", "--depth-scale", 0.01) == EXIT_OK
    assert "is --depth-scale right?" in str(facts_of(tmp_path / "out")["resolution"])
    assert run(scene, tmp_path / "right", "--every", 2) == EXIT_OK
    assert "--depth-scale" not in str(facts_of(tmp_path / "right")["resolution"])


def test_a_displaced_world_is_noted(scene: Path, tmp_path: Path):
    pose = np.loadtxt(scene / "pose.txt")
    pose[0, 3] += 5
    np.savetxt(tmp_path / "pose.txt", pose)
    assert run(scene, tmp_path / "out", "--camera-pose", tmp_path / "pose.txt") == EXIT_OK
    assert "the middle of the table in view lies at (5.0" in str(facts_of(tmp_path / "out")["world"])


def test_shipped_weights_are_given_by_their_name(scene: Path, tmp_path: Path):
    assert run(scene, tmp_path / "out", checkpoint="obpose--moving--64x64") == EXIT_OK
    assert facts_of(tmp_path / "out")["checkpoint"] == "obpose--moving--64x64"


@pytest.mark.parametrize(
    ("changes", "flags", "code", "message"),
    [
        ({"checkpoint": "nowhere"}, (), EXIT_USAGE, "nowhere: no such folder"),
        ({"checkpoint": "{scene}/rgb"}, (), EXIT_USAGE, "rgb holds no model"),
        ({"rgb": "{scene}/none.png", "depth": "{scene}/depth/0.png"}, (), EXIT_USAGE, "none.png does not exist"),
        ({"depth": "{scene}/rgb"}, (), EXIT_USAGE, "holds no depth"),
        ({"depth": "{scene}/depth/0.png"}, (), EXIT_USAGE, "names 2 images and --depth 1"),
        ({"rgb": "{scene}/pose.txt", "depth": "{scene}/depth/0.png"}, (), EXIT_INCOMPLETE, "damaged or no image"),
        ({}, ("--intrinsics", "1,2,3"), EXIT_USAGE, "expected fx,fy,cx,cy"),
        ({}, ("--depth-scale", 0), EXIT_USAGE, "--depth-scale is 0"),
        ({}, ("--depth-scale", "inf"), EXIT_USAGE, "--depth-scale is inf"),
        ({}, ("--depth-scale", 1), EXIT_USAGE, "median depth is"),
        ({}, ("--every", 100), EXIT_USAGE, "--every 100"),
        ({}, ("--every", 0), EXIT_USAGE, "--every 0"),
        ({}, ("--camera-pose", "nowhere.txt"), EXIT_USAGE, "nowhere.txt does not exist"),
    ],
)
def test_bad_requests_end_with_one_line(scene: Path, tmp_path: Path, capsys, changes, flags, code: int, message: str):
    places = {name: value.format(scene=scene) for name, value in changes.items()}
    assert run(scene, tmp_path / "out", *flags, **places) == code
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1
    assert message in errors
    assert not (tmp_path / "out").exists()


def test_a_first_frame_without_depth_is_refused(scene: Path, tmp_path: Path, capsys):
    depth = tmp_path / "depth"
    shutil.copytree(scene / "depth", depth)
    first = min(depth.iterdir())
    Image.fromarray(np.zeros_like(np.array(Image.open(first)))).save(first)
    assert run(scene, tmp_path / "out", "--camera-pose", scene / "pose.txt", depth=depth) == EXIT_USAGE
    assert (
        "first frame has no depth, and objects are looked for there: leave out its image and its depth"
        in capsys.readouterr().err
    )


def test_saturated_and_far_depth_leave_the_world_in_place(scene: Path, tmp_path: Path):
    def place(name: str, value: int) -> np.ndarray:
        (tmp_path / name).mkdir()
        for path in (scene / "depth").iterdir():
            depth = np.array(Image.open(path))
            depth[:3] = value
            Image.fromarray(depth).save(tmp_path / name / path.name)
        assert run(scene, tmp_path / f"{name}_out", depth=tmp_path / name) == EXIT_OK
        return np.array(facts_of(tmp_path / f"{name}_out")["world_from_camera"])

    without = place("without", 0)
    np.testing.assert_array_equal(place("saturated", 65535), without)
    np.testing.assert_allclose(place("wall", 6000), without, atol=0.02)


def test_an_existing_folder_is_left_alone(scene: Path, tmp_path: Path, capsys):
    (tmp_path / "objects.json").write_text("mine")
    assert run(scene, tmp_path) == EXIT_USAGE
    assert "already exists and is not empty; give another --out" in capsys.readouterr().err
    for flags, message in (
        (("--every", 0), "--every 0"),
        (("--intrinsics", "1,2,3"), "expected fx,fy,cx,cy"),
        (("--camera-pose", "nowhere.txt"), "nowhere.txt does not exist"),
        (("--rgb", "nowhere"), "--rgb nowhere does not exist"),
        (("--checkpoint", "nowhere"), "--checkpoint nowhere: no such folder"),
    ):
        assert run(scene, tmp_path, *flags) == EXIT_USAGE
        assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["objects.json"]
    assert (tmp_path / "objects.json").read_text() == "mine"
