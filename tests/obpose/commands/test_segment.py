import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, EXIT_USAGE, UsageError
from datagen.geometry import look_at, pixel_rays
from obpose.commands.segment import Arguments, _prepared, _unlike_training, main
from obpose.config import override
from obpose.contact.config import ContactConfig
from obpose.contact.model import ContactModel
from obpose.data.clips import ArrayClips
from obpose.data.scene_stats import measure_scene
from obpose.model.build import build_obpose
from obpose.rgbd.weights import DEFAULT, method_of
from obpose.rgbd.world import World
from obpose.storage.checkpoint import load, save_model
from obpose.systems import find_system
from obpose.types import Observation
from tests.worlds.observations import table_scene
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
    system = find_system("obpose")
    measures = system.known(measure_scene(ArrayClips([clip])).changes())
    config = system.config("cpu", {"model.slots": 2, **measures})
    torch.manual_seed(0)
    model = build_obpose(config)
    with torch.no_grad():
        model.heads.prescope[-1].bias.copy_(torch.tensor([0.0, 5.0]))
    save_model(folder / "model", model.state_dict(), config, {})
    return folder


def one_object(observation: Observation) -> np.ndarray:
    """Give every pixel the same label."""
    return np.ones(observation.depth[0, :, 0].shape, np.int64)


def find_method(name: str, objects: int):
    if name != "one-object":
        raise UsageError(f"Unknown method {name!r}; expected one-object.")
    return one_object


def run(scene: Path, out: Path, *flags: object, **changes: object) -> int:
    given = {"checkpoint": scene / "model", "rgb": scene / "rgb", "depth": scene / "depth", **changes}
    command = [part for name, value in given.items() if value for part in (f"--{name}", str(value))]
    camera = ["--intrinsics", (scene / "intrinsics").read_text()]
    return main([*command, *camera, *map(str, flags), "--out", str(out)], find_method=find_method)


def facts_of(out: Path) -> dict[str, object]:
    return json.loads((out / "objects.json").read_text())


def labels_of(out: Path) -> np.ndarray:
    return np.stack([np.asarray(Image.open(out / frame["labels"])) for frame in facts_of(out)["frames"]])


def test_frames_become_labels_overlays_and_boxes(scene: Path, tmp_path: Path, capsys):
    assert run(scene, tmp_path, "--camera-pose", scene / "pose.txt") == EXIT_OK
    facts = facts_of(tmp_path)
    assert facts["world"] == "as given by the camera's pose"
    np.testing.assert_allclose(facts["frames"][0]["world_from_camera"], np.loadtxt(scene / "pose.txt"), atol=1e-6)
    assert len(facts["frames"]) == FRAMES
    for frame, labels in zip(facts["frames"], labels_of(tmp_path), strict=True):
        assert labels.shape == (HEIGHT, WIDTH)
        assert all(each["pixels"] == np.sum(labels == each["label"]) for each in frame["objects"])
    assert str(tmp_path / "objects.json") in capsys.readouterr().out


def test_without_a_pose_the_world_stands_on_the_table(scene: Path, tmp_path: Path, capsys):
    assert run(scene, tmp_path) == EXIT_OK
    assert "stands on the table" in str(facts_of(tmp_path)["world"])
    assert "stands on the table" in capsys.readouterr().out
    height = np.array(facts_of(tmp_path)["frames"][0]["world_from_camera"])[2, 3]
    assert height == pytest.approx(np.loadtxt(scene / "pose.txt")[2, 3], abs=0.01)


def test_a_method_without_training_segments_what_stands_on_the_table(scene: Path, tmp_path: Path):
    assert run(scene, tmp_path, checkpoint=None, method="one-object") == EXIT_OK
    truth = clip_and_truth(frames=FRAMES, resolution=(WIDTH, HEIGHT))[1][:, 0]
    found = labels_of(tmp_path)
    assert facts_of(tmp_path)["method"] == "one-object, without training"
    assert np.mean(found[truth > 0] == 1) > 0.85
    assert np.mean(found[truth == 0] == 0) > 0.99
    (entry,) = facts_of(tmp_path)["frames"][0]["objects"]
    assert len(entry["size"]) == 3


def test_objects_wider_than_in_training_are_reported(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for scale, warned in ((0.001, False), (0.002, True)):
        out = tmp_path / str(scale)
        assert run(scene, out, "--depth-scale", scale, checkpoint=None, method="one-object") == EXIT_OK
        assert (
            "Warning: Label 1 is in some frame wider than any object of the dataset desk, 35 cm. It may be"
            in capsys.readouterr().out
        ) == warned


def test_a_wide_object_in_a_later_frame_is_reported(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    depth = tmp_path / "depth"
    shutil.copytree(scene / "depth", depth)
    first = min(depth.iterdir())
    Image.fromarray(np.zeros_like(np.array(Image.open(first)))).save(first)
    doubled = {"checkpoint": None, "method": "one-object", "depth-scale": 0.002}
    assert run(scene, tmp_path / "out", depth=depth, **doubled) == EXIT_OK
    assert "Warning: Label 1 is in some frame wider than any object" in capsys.readouterr().out


def test_intrinsics_of_another_size_and_a_grid_of_holes_are_reported(scene: Path, tmp_path: Path):
    def warnings(name: str, *flags: object, **changes: object) -> object:
        assert run(scene, tmp_path / name, *flags, checkpoint=None, method="one-object", **changes) == EXIT_OK
        return facts_of(tmp_path / name)["warnings"]

    assert warnings("right") == []
    fx, fy, cx, cy = (float(part) for part in (scene / "intrinsics").read_text().split(","))
    (said,) = warnings("half", "--intrinsics", f"{fx},{fy},{cx / 2},{cy / 2}")
    assert "far from the middle of the 32x24 images" in said
    (tmp_path / "depth").mkdir()
    for path in (scene / "depth").iterdir():
        depth = np.array(Image.open(path))
        depth[1::3] = 0
        Image.fromarray(depth).save(tmp_path / "depth" / path.name)
    (said,) = warnings("holes", "--every", 3, depth=tmp_path / "depth")
    assert said.startswith("Only 0 % of the pixels that --every 3 picks have a depth, and 67 % of all")
    assert warnings("no grid", "--every", 2, depth=tmp_path / "depth") == []


def test_a_scene_that_is_too_near_for_a_depth_camera_is_reported(scene: Path, tmp_path: Path):
    assert run(scene, tmp_path, "--depth-scale", 1.5e-4, checkpoint=None, method="one-object") == EXIT_OK
    (said,) = facts_of(tmp_path)["warnings"]
    assert said.startswith("The median depth is 0.1")
    assert "Check the metres per unit" in said


def test_images_that_are_coarser_than_those_of_training_are_reported(scene: Path, tmp_path: Path):
    for kind in ("rgb", "depth"):
        (tmp_path / kind).mkdir()
        for path in (scene / kind).iterdir():
            Image.fromarray(np.array(Image.open(path))[::2, ::2]).save(tmp_path / kind / path.name)
    half = ",".join(str(float(value) / 2) for value in (scene / "intrinsics").read_text().split(","))
    coarse = {"rgb": tmp_path / "rgb", "depth": tmp_path / "depth"}
    flags = ("--camera-pose", scene / "pose.txt")
    assert run(scene, tmp_path / "coarse", "--intrinsics", half, *flags, **coarse) == EXIT_OK
    (said,) = facts_of(tmp_path / "coarse")["warnings"]
    assert said.startswith("Neighbouring pixels are 1.6 times as far apart as in training")
    assert run(scene, tmp_path / "right", *flags) == EXIT_OK
    assert facts_of(tmp_path / "right")["warnings"] == []


def test_messages_about_intrinsics_name_their_source(scene: Path, tmp_path: Path, capsys):
    for kind in ("rgb", "depth"):
        shutil.copytree(scene / kind, tmp_path / "a" / kind)
    wrong = json.dumps({"fx": 1, "fy": 1, "cx": 1, "cy": 1})
    (tmp_path / "a" / "camera.json").write_text(wrong)
    for flags, place in (((), "camera.json: fx"), (("--intrinsics", "1,1,1,1"), "obpose-segment: --intrinsics: fx")):
        command = [str(tmp_path / "a"), *flags, "--method", "one-object", "--out", str(tmp_path / "out")]
        assert main(command, find_method=find_method) == EXIT_USAGE
        assert place in capsys.readouterr().err


def test_pixels_are_as_far_apart_as_in_training(scene: Path, tmp_path: Path):
    clip = clip_and_truth(frames=1, resolution=(3 * WIDTH, 3 * HEIGHT))[0]
    Image.fromarray(clip.rgb[0, 0]).save(tmp_path / "a.png")
    np.save(tmp_path / "d.npy", clip.depth[0, 0])
    k = ",".join(str(3 * float(value)) for value in (scene / "intrinsics").read_text().split(","))
    command = ("--intrinsics", k, "--camera-pose", scene / "pose.txt")
    changes = {"rgb": tmp_path / "a.png", "depth": tmp_path / "d.npy"}
    assert run(scene, tmp_path / "auto", *command, **changes) == EXIT_OK
    assert f"{WIDTH}x{HEIGHT} pixels (--every 3)" in str(facts_of(tmp_path / "auto")["resolution"])
    assert run(scene, tmp_path / "given", *command, "--every", 2, **changes) == EXIT_OK
    assert "(--every 2)" in str(facts_of(tmp_path / "given")["resolution"])
    assert labels_of(tmp_path / "given").shape == (1, 3 * HEIGHT, 3 * WIDTH)


def test_distances_from_the_cameras_centre_are_converted(scene: Path, tmp_path: Path):
    clip = clip_and_truth(frames=FRAMES, resolution=(WIDTH, HEIGHT))[0]
    lengths = np.linalg.norm(pixel_rays(clip.k[0], WIDTH, HEIGHT), axis=-1)
    for frame, depth in enumerate(clip.depth[:, 0]):
        np.save(tmp_path / f"{frame}.npy", (depth * lengths).astype(np.float32))
    flags = ("--camera-pose", scene / "pose.txt", "--euclidean")
    changes = {"checkpoint": None, "method": "one-object"}
    assert run(scene, tmp_path / "planar", *flags[:2], **changes) == EXIT_OK
    files = [tmp_path / f"{frame}.npy" for frame in range(FRAMES)]
    assert run(scene, tmp_path / "ray", *flags, "--depth", *files, depth=None, **changes) == EXIT_OK
    assert np.mean(labels_of(tmp_path / "planar") != labels_of(tmp_path / "ray")) < 0.02


def test_the_workspace_can_be_given(scene: Path, tmp_path: Path):
    flags = {"checkpoint": None, "method": "one-object"}
    pose = ("--camera-pose", scene / "pose.txt")
    assert run(scene, tmp_path / "all", *pose, **flags) == EXIT_OK
    found = labels_of(tmp_path / "all")[0]
    y = facts_of(tmp_path / "all")["frames"][0]["objects"][0]["center"][1]
    assert run(scene, tmp_path / "half", *pose, f"--workspace=-2,2,{y},2", **flags) == EXIT_OK
    assert 0 < np.sum(labels_of(tmp_path / "half")[0] > 0) < np.sum(found > 0)
    assert run(scene, tmp_path / "near", *pose, "--depth-max", 0.01, **flags) == EXIT_USAGE


def test_the_choice_depends_on_the_camera_and_is_named(scene: Path, tmp_path: Path):
    def chosen(name: str, pose: np.ndarray) -> str:
        method, _, _ = _prepared(Arguments(**files, camera_pose=save(name, pose)), find_method, 16)
        return method

    def save(name: str, pose: np.ndarray) -> Path:
        np.savetxt(tmp_path / name, pose)
        return tmp_path / name

    places = {"rgb": (scene / "rgb",), "depth": (scene / "depth",)}
    files = {**places, "intrinsics": (scene / "intrinsics").read_text()}
    assert chosen("near", np.loadtxt(scene / "pose.txt")).startswith(
        f"weights {DEFAULT}, chosen because the camera is at most 2.6 m away"
    )
    for position, said in (((2.0, 0.0, 2.0), "2.8 m away, farther"), ((1.0, 0.0, 0.2), "11 degrees above the table")):
        pose = look_at(np.array(position), np.zeros(3))
        assert said in _unlike_training(World(pose[None], ""))


def test_weights_of_obpose_look_for_as_many_objects_as_wanted(scene: Path):
    assert load(scene / "model")[0].attention.slots == 2
    method, _ = method_of(scene / "model", 5)
    assert method.args[0].attention.slots == 5


def test_weights_of_another_table_see_heights_above_that_of_the_frames(tmp_path: Path):
    config = override(ContactConfig(), {"model.table": 0.5})
    save_model(tmp_path, ContactModel(config).state_dict(), config, {})
    method, _ = method_of(tmp_path)
    images = method.args[0].images(table_scene(frames=1))
    assert images.points[:, 2][images.valid].median() == pytest.approx(0, abs=1e-3)


def test_a_full_number_of_objects_is_reported(scene: Path, tmp_path: Path, capsys):
    flags = {"checkpoint": None, "method": "one-object"}
    for number in (1, 2):
        assert run(scene, tmp_path / str(number), "--objects", number, **flags) == EXIT_OK
        said = "Warning: As many objects were found as were looked for, 1" in capsys.readouterr().out
        assert said == bool(facts_of(tmp_path / str(number))["warnings"]) == (number == 1)


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
        ({}, ("--depth-scale", 0.01), EXIT_USAGE, "depth in the right unit (--depth-scale)"),
        ({}, ("--every", 24), EXIT_USAGE, "--every 24 leaves 1x1 of the 32x24 pixels; expected at least 8"),
        ({}, ("--every", 10**30), EXIT_USAGE, "leaves 0x0 of the 32x24 pixels"),
        ({}, ("--every", 4), EXIT_USAGE, "--every 4 leaves 8x6 of the 32x24 pixels; expected at least 8"),
        ({}, ("--every", 0), EXIT_USAGE, "--every 0"),
        ({}, ("--camera-pose", "nowhere.txt"), EXIT_USAGE, "nowhere.txt does not exist"),
        ({}, ("--depth-max", 0), EXIT_USAGE, "--depth-max is 0"),
        ({}, ("--workspace", "1,0,0,1"), EXIT_USAGE, "expected x0,x1,y0,y1"),
        ({}, ("--workspace", "5,6,5,6"), EXIT_USAGE, "The workspace shows no points"),
        ({}, ("--table", "5"), EXIT_USAGE, "--table 5: expected column,row of a pixel"),
        ({}, ("--objects", 0), EXIT_USAGE, "--objects 0: expected 1 to 255"),
        ({}, ("{scene}",), EXIT_USAGE, "and --rgb or --depth exclude each other"),
        ({"rgb": None, "depth": None}, ("{scene}/model",), EXIT_USAGE, "model holds no frames"),
        ({"rgb": None, "depth": None}, ("{scene}/nowhere",), EXIT_USAGE, "nowhere does not exist"),
        ({}, ("--method", "one-object"), EXIT_USAGE, "--method and --checkpoint exclude each other"),
        ({"checkpoint": None}, ("--method", "magic"), EXIT_USAGE, "Unknown method 'magic'"),
    ],
)
def test_bad_requests_end_with_one_line(scene: Path, tmp_path: Path, capsys, changes, flags, code: int, message: str):
    places = {name: value and value.format(scene=scene) for name, value in changes.items()}
    given = [flag.format(scene=scene) if isinstance(flag, str) else flag for flag in flags]
    assert run(scene, tmp_path / "out", *given, **places) == code
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1
    assert message in errors
    assert not (tmp_path / "out").exists()


def test_an_archive_without_a_camera_says_what_is_missing(tmp_path: Path, capsys):
    np.savez(tmp_path / "a.npz", rgb=np.zeros((4, 4, 3), np.uint8), depth=np.ones((4, 4)))
    command = [str(tmp_path / "a.npz"), "--out", str(tmp_path / "out")]
    assert main(command, find_method=find_method) == EXIT_USAGE
    assert "a.npz holds no array K, and there is no camera.json beside it; write one" in capsys.readouterr().err


def test_a_first_frame_without_depth_is_skipped(scene: Path, tmp_path: Path):
    depth = tmp_path / "depth"
    shutil.copytree(scene / "depth", depth)
    first = min(depth.iterdir())
    Image.fromarray(np.zeros_like(np.array(Image.open(first)))).save(first)
    flags = {"checkpoint": None, "method": "one-object", "depth": depth}
    assert run(scene, tmp_path / "out", **flags) == EXIT_OK
    assert [labels.max() for labels in labels_of(tmp_path / "out")] == [0, 1]


def test_saturated_and_far_depth_leave_the_world_in_place(scene: Path, tmp_path: Path):
    def place(name: str, value: int) -> np.ndarray:
        (tmp_path / name).mkdir()
        for path in (scene / "depth").iterdir():
            depth = np.array(Image.open(path))
            depth[:3] = value
            Image.fromarray(depth).save(tmp_path / name / path.name)
        assert run(scene, tmp_path / f"{name}_out", depth=tmp_path / name) == EXIT_OK
        return np.array(facts_of(tmp_path / f"{name}_out")["frames"][0]["world_from_camera"])

    without = place("without", 0)
    np.testing.assert_array_equal(place("saturated", 65535), without)
    np.testing.assert_allclose(place("wall", 6000), without, atol=0.02)


def test_an_existing_folder_is_left_alone(scene: Path, tmp_path: Path, capsys):
    (tmp_path / "mine.txt").write_text("mine")
    assert run(scene, tmp_path) == EXIT_USAGE
    assert "already exists and is not empty; give another --out, nothing" in capsys.readouterr().err
    (tmp_path / "mine.txt").rename(tmp_path / "objects.json")
    assert run(scene, tmp_path) == EXIT_USAGE
    assert "give another --out, or --overwrite to replace the earlier result" in capsys.readouterr().err
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
