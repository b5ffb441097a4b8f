"""The whole command, with the weights that ship."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from torch import Tensor

from datagen.errors import EXIT_OK, EXIT_USAGE
from datagen.schema import decode_depth
from datagen.storage.reader import Dataset
from obpose.commands import edit as edit_cli
from obpose.commands.edit_arguments import main
from obpose.data.clips import observation_of
from obpose.data.datasets import SceneDataset
from obpose.geometry import unproject
from obpose.rgbd.frame_arguments import Frames
from obpose.rgbd.frames import PreparedFrames
from obpose.rgbd.weights import DEFAULT, segment_reduced
from obpose.scenes.appearance.light import no_light, strength
from obpose.scenes.bounds import workspace_bounds
from obpose.scenes.model_ref import load_origin, origin_of
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import ClipName, upright
from obpose.scenes.storage import load_scene

MODEL = "obpose--moving--64x64"
SMALL = ("--resolution", "16x16")
"""Size of pictures at which nobody looks."""


def run(command: str, *arguments: object) -> int:
    return main([command, *map(str, arguments)])


def test_what_is_inferred_looks_like_the_clip(inferred: Path, tiny_dataset: Path):
    scene = load_scene(inferred)
    assert scene.frames == 4
    assert scene.clip == ClipName(SceneDataset(tiny_dataset).settings_hash, "test", 0)
    assert 1 <= len(scene.ids) <= 4
    with Image.open(inferred / "picture.png") as picture:
        assert picture.size == (768, 256)
    clip = tiny_dataset_clip(tiny_dataset)
    assert run("render", inferred, "--out", inferred.parent / "frame.png") == EXIT_OK
    image = Renderer(origin_of(scene).model).render(scene)
    assert (image.rgb - clip["rgb"][0, 0]).square().mean() < 0.02
    table = clip["segmentation"][0, 0] == 0
    assert (image.depth - clip["depth"][0, 0])[table].abs().median() < 0.01


def tiny_dataset_clip(folder: Path) -> dict[str, torch.Tensor]:
    return SceneDataset(folder, "test", extra=["segmentation"])[0]


@pytest.fixture(scope="module")
def frames(tiny_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Files of the clip, and the flags that name them."""
    folder, clip = tmp_path_factory.mktemp("frames"), Dataset(tiny_dataset).split("test")[0]
    for kind in ("rgb", "depth"):
        (folder / kind).mkdir()
    for frame in range(len(clip["rgb"])):
        Image.fromarray(clip["rgb"][frame, 0]).save(folder / "rgb" / f"{frame}.png")
        np.save(folder / "depth" / f"{frame}.npy", decode_depth(clip["depth"][frame, 0]))
    np.savetxt(folder / "pose.txt", clip["camera/world_from_camera"][0])
    k = clip["camera/K"][0]
    camera = ["--intrinsics", ",".join(str(value) for value in (k[0, 0], k[1, 1], k[0, 2], k[1, 2]))]
    return ["--rgb", str(folder / "rgb"), "--depth", str(folder / "depth"), *camera, f"--camera-pose={folder}/pose.txt"]


def test_frames_of_ones_own_give_the_scene_of_the_same_clip(inferred: Path, frames: list[str], tmp_path: Path, capsys):
    flags = ("--masks", "own", "--refine", 0, "--out", tmp_path / "own")
    assert run("infer", "--checkpoint", MODEL, *frames, *flags) == EXIT_OK
    told = capsys.readouterr().out
    assert f"Weights: {MODEL}; masks: their own." in told
    assert "World: as given by the camera's pose." in told
    own, scene = load_scene(tmp_path / "own"), load_scene(inferred)
    assert own.clip is None
    assert own.ids == scene.ids
    # Colours differ in their last digit, which frame after frame makes half a millimetre of.
    torch.testing.assert_close(own.center, scene.center, atol=5e-3, rtol=0)
    torch.testing.assert_close(own.what, scene.what, atol=0.1, rtol=0)


def test_an_empty_noisy_table_has_no_objects(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """The plane z = 0, 1 m before the camera, with 1 mm of noise. Without the filters of frames, 5 objects appear."""
    rng, slope = np.random.default_rng(0), math.sqrt(0.5)
    pose = np.array([[0, -slope, slope, -slope], [-1, 0, 0, 0], [0, -slope, -slope, slope], [0, 0, 0, 1]])
    down = (np.arange(64) + 0.5 - 32) / 70
    depth = np.tile((1 / (1 + down))[:, None], 64) + rng.normal(0, 0.001, (64, 64))
    np.save(tmp_path / "depth.npy", depth.astype(np.float32))
    np.savetxt(tmp_path / "pose.txt", pose)
    Image.fromarray(rng.integers(0, 255, (64, 64, 3), dtype=np.uint8)).save(tmp_path / "rgb.png")
    files = [f"--{name}={tmp_path / file}" for name, file in (("rgb", "rgb.png"), ("depth", "depth.npy"))]
    flags = ("--intrinsics", "70,70,32,32", f"--camera-pose={tmp_path}/pose.txt", "--masks", "own", "--refine", 0)
    weights = "obpose-contact--mixed--64x64"
    assert run("infer", "--checkpoint", weights, *files, *flags, "--out", tmp_path / "scene") == EXIT_OK
    assert "No object was found" in capsys.readouterr().out


def in_another_world(frames: list[str], folder: Path, *, axis: int, by: float) -> list[str]:
    """Flags with a camera that was moved along an axis, metres."""
    *others, camera = frames
    pose = np.loadtxt(camera.removeprefix("--camera-pose="))
    pose[axis, 3] += by
    np.savetxt(folder / "pose.txt", pose)
    return [*others, f"--camera-pose={folder}/pose.txt"]


def test_the_contact_model_finds_the_objects_of_frames(frames: list[str], tmp_path: Path, tiny_dataset: Path):
    assert run("infer", "--checkpoint", MODEL, *frames, "--refine", 0, "--out", tmp_path / "frames") == EXIT_OK
    flags = ("--data", tiny_dataset, "--masks", DEFAULT, "--refine", 0)
    assert run("infer", "--checkpoint", MODEL, *flags, "--out", tmp_path / "clip") == EXIT_OK
    points = unproject(observation_of([tiny_dataset_clip(tiny_dataset)]))[0, 0, 0]
    truth = tiny_dataset_clip(tiny_dataset)["segmentation"][0, 0]
    means = torch.stack([points[truth == name].mean(dim=0) for name in truth.unique()[1:].tolist()])
    for place in ("frames", "clip"):
        centers = load_scene(tmp_path / place).center[0]
        # Two of the four objects touch in all but the first frame, and are one for the network.
        assert len(centers) >= len(means) - 1
        assert torch.cdist(means, centers).amin(dim=1).sort().values[:-1].max() < 0.1


@pytest.mark.parametrize("own", [False, True])
def test_the_default_weights_are_those_of_obpose_contact(
    tiny_dataset: Path, frames: list[str], own: bool, tmp_path: Path
):
    flags = [*frames, "--masks", "own"] if own else ["--data", tiny_dataset]
    assert run("infer", *flags, "--refine", 0, "--out", tmp_path / "own") == EXIT_OK
    assert load_scene(tmp_path / "own").checkpoint == "obpose-contact--moving--64x64"


def test_masks_come_from_weights_of_the_contact_model(tiny_dataset: Path, tmp_path: Path, capsys):
    expected = "expected weights of obpose-contact, contact-masks, supervised or ogc"
    for masks, reason in ((MODEL, expected), ("nope", "--masks nope: no such folder")):
        flags = ("--data", tiny_dataset, "--masks", masks, "--out", tmp_path / "out")
        assert run("infer", "--checkpoint", MODEL, *flags) == EXIT_USAGE
        assert reason in capsys.readouterr().err


def test_what_frames_show_outside_the_workspace_is_left_out(frames: list[str], tmp_path: Path, capsys):
    flags = in_another_world(frames, tmp_path, axis=0, by=-0.5)
    code = run("infer", "--checkpoint", MODEL, *flags, "--refine", 0, "--out", tmp_path / "own")
    assert (code, capsys.readouterr().err) == (EXIT_OK, "")
    low, high = workspace_bounds(load_origin(MODEL).model)
    centers = load_scene(tmp_path / "own").center
    assert ((centers > low - 0.011) & (centers < high + 0.001)).all()


def test_objects_of_the_masks_that_are_left_out_are_named(
    frames: list[str], tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
):
    def with_one_outside(checkpoint: str, flags: Frames, prepared: PreparedFrames) -> Tensor:
        labels = segment_reduced(checkpoint, flags, prepared)
        labels[~prepared.observation.valid] = 9
        return labels

    monkeypatch.setattr(edit_cli, "segment_reduced", with_one_outside)
    flags = in_another_world(frames, tmp_path, axis=0, by=-0.5)
    assert run("infer", "--checkpoint", MODEL, *flags, "--refine", 0, "--out", tmp_path / "own") == EXIT_OK
    assert "Object 9 of the masks is left out: it is outside of the workspace" in capsys.readouterr().out
    assert 9 not in load_scene(tmp_path / "own").ids


def test_masks_that_are_wider_than_an_object_are_reported(
    frames: list[str], tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
):
    def all_of_it(checkpoint: str, flags: Frames, prepared: PreparedFrames) -> Tensor:
        return prepared.observation.valid.long()

    monkeypatch.setattr(edit_cli, "segment_reduced", all_of_it)
    assert run("infer", "--checkpoint", MODEL, *frames, "--refine", 0, "--out", tmp_path / "own") == EXIT_OK
    assert "Warning: Label 1 is in some frame wider than any object" in capsys.readouterr().out


def test_a_table_that_is_not_at_zero_gets_a_world_of_its_own(frames: list[str], tmp_path: Path, capsys):
    flags = in_another_world(frames, tmp_path, axis=2, by=-0.4)
    assert run("infer", "--checkpoint", MODEL, *flags, "--refine", 0, "--out", tmp_path / "own") == EXIT_OK
    assert "not that of the given poses, where the table lies at z = -0.40 m" in capsys.readouterr().out


@pytest.mark.slow
def test_a_refined_scene_is_nearer_to_its_frames(inferred: Path, tiny_dataset: Path, tmp_path: Path, capsys):
    flags = ["--checkpoint", MODEL, "--data", tiny_dataset, "--out", tmp_path / "refined", "--refine"]
    assert run("infer", *flags, -1) == EXIT_USAGE
    assert "--refine -1: expected 0 to 10000" in capsys.readouterr().err
    assert run("infer", *flags, 30) == EXIT_OK
    told = capsys.readouterr().out
    assert "Resolution: neighbouring pixels are" in told
    before, after = load_scene(inferred), load_scene(tmp_path / "refined")
    renderer, clip = Renderer(origin_of(after).model), tiny_dataset_clip(tiny_dataset)
    without = after.with_appearance(detail=torch.zeros_like(after.appearance.detail))
    errors = [(renderer.render(scene).rgb - clip["rgb"][0, 0]).square().mean() for scene in (before, without, after)]
    assert errors[2] < errors[1]
    assert errors[2] < 0.9 * errors[0]
    assert after.ids == before.ids
    assert ("No light was found" in told) == (strength(after.appearance.light) == 0)


def test_it_is_said_that_no_light_was_found(tiny_dataset: Path, tmp_path: Path, capsys, monkeypatch):
    monkeypatch.setattr("obpose.scenes.infer.find_light", lambda *_: no_light())
    for steps, told in ((0, False), (1, True)):
        flags = ["--checkpoint", MODEL, "--data", tiny_dataset, "--refine", steps, "--out", tmp_path / f"{steps}"]
        assert run("infer", *flags) == EXIT_OK
        assert ("No light was found" in capsys.readouterr().out) == told


def test_edits_are_scenes_again(inferred: Path, tmp_path: Path):
    before = load_scene(inferred)
    name = before.ids[0]
    assert run("move", inferred, *SMALL, "--object", name, "--by", "0.05,0,0", "--out", tmp_path / "moved") == EXIT_OK
    moved = load_scene(tmp_path / "moved")
    torch.testing.assert_close(moved.center[:, 0, 0], before.center[:, 0, 0] + 0.05)
    assert (
        run("add", tmp_path / "moved", *SMALL, "--object", name, "--by=-0.1,0,0", "--out", tmp_path / "added")
        == EXIT_OK
    )
    assert load_scene(tmp_path / "added").ids == (*before.ids, max(before.ids) + 1)
    assert run("remove", tmp_path / "added", *SMALL, "--object", name, "--out", tmp_path / "removed") == EXIT_OK
    assert name not in load_scene(tmp_path / "removed").ids
    assert run("rotate", inferred, *SMALL, "--object", name, "--degrees", 90, "--out", tmp_path / "turned") == EXIT_OK
    quarter = upright(math.pi / 2, before.rotation)
    torch.testing.assert_close(load_scene(tmp_path / "turned").rotation[:, 0], quarter @ before.rotation[:, 0])
    pair = ["--objects", name, max(before.ids) + 1]
    assert run("swap", tmp_path / "added", *SMALL, *pair, "--out", tmp_path / "swapped") == EXIT_OK
    added, swapped = load_scene(tmp_path / "added"), load_scene(tmp_path / "swapped")
    torch.testing.assert_close(swapped.center[:, [0, -1], :2], added.center[:, [-1, 0], :2])
    other = ["--object", name, "--from", inferred, "--to", "0,0,0.05"]
    assert run("add", tmp_path / "removed", *SMALL, *other, "--out", tmp_path / "put") == EXIT_OK
    torch.testing.assert_close(load_scene(tmp_path / "put").center[0, -1], torch.tensor([0.0, 0.0, 0.05]))


def test_turns_and_clips_are_animations(inferred: Path, tmp_path: Path, capsys):
    assert run("render", inferred, "--turntable", 3, *SMALL, "--out", tmp_path / "turn.gif") == EXIT_OK
    # The one camera of `moving` never looked from there.
    assert re.search("In [12] of 3 pictures there is fog before the scene", capsys.readouterr().out)
    assert run("render", inferred, "--clip", *SMALL, "--out", tmp_path / "clip.gif") == EXIT_OK
    for name, frames in (("turn.gif", 3), ("clip.gif", 4)):
        with Image.open(tmp_path / name) as animation:
            assert animation.n_frames == frames  # pyright: ignore[reportAttributeAccessIssue]


def test_a_clear_turn_is_not_said_to_have_fog(inferred: Path, tmp_path: Path, capsys):
    assert run("render", inferred, "--turntable", 1, *SMALL, "--out", tmp_path / "turn.gif") == EXIT_OK
    assert "fog" not in capsys.readouterr().out


def test_the_camera_is_turned_beside_the_scene(inferred: Path, tmp_path: Path):
    def rendered(degrees: int) -> np.ndarray:
        out = tmp_path / f"{degrees}.png"
        assert run("render", inferred, "--beside", degrees, *SMALL, "--out", out) == EXIT_OK
        return np.asarray(Image.open(out)).astype(int)

    front, back, around = rendered(0), rendered(180), rendered(360)
    assert np.abs(front - around).mean() < 1 < np.abs(front - back).mean()


def test_an_object_is_written_as_a_mesh(inferred: Path, tmp_path: Path, capsys):
    name = load_scene(inferred).ids[0]
    assert run("mesh", inferred, "--object", name, "--out", tmp_path / "object.glb") == EXIT_OK
    assert re.search(r"triangles, [\d.]+ x [\d.]+ x [\d.]+ cm along the axes of", capsys.readouterr().out)
    assert trimesh.load(tmp_path / "object.glb", force="mesh").extents.max() < 0.4  # pyright: ignore


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["move", "SCENE", "--object", "1", "--by", "1,2", "--out", "new"], "expected x,y,z in metres"),
        (["move", "SCENE", "--object", "FIRST", "--to", "0,0,-0.43", "--out", "new"], "z 0.00 to 0.57 m in all frames"),
        (["add", "SCENE", "--object", "FIRST", "--to", "0,0.6,0.05", "--out", "new"], "would be outside the workspace"),
        (["move", "SCENE", "--object", "1", "--by", "nan,0,0", "--out", "new"], "expected x,y,z in metres"),
        (["remove", "SCENE", "--object", "1", "--out", "SCENE"], "already exists and is not empty"),
        (["render", "SCENE", "--out", "SCENE/picture.png"], "already exists"),
        (["render", "SCENE", "--out", "a.jpg"], "expected a name that ends with .png"),
        (["render", "SCENE", "--turntable", "999", "--out", "a.gif"], "--turntable 999: expected 1 to 360"),
        (["render", "SCENE", "--beside", "inf", "--out", "a.png"], "--beside inf: expected a finite number"),
        (["render", "SCENE", "--turntable", "0", "--out", "a.gif"], "--turntable 0: expected 1 to 360"),
        (["render", "SCENE", "--view", "1", "--out", "a.png"], "--view 1: expected 0"),
        (["render", "SCENE", "--out", "a.gif"], "ends with .png, or --turntable or --clip for an animation"),
        (["render", "SCENE", "--clip", "--frame", "0", "--out", "a.gif"], "leave out --turntable and --frame, or it"),
        (["render", "SCENE", "--clip", "--turntable", "3", "--out", "a.gif"], "--clip shows all frames from where"),
        (["render", "SCENE", "--resolution", "9999x2", "--out", "a.png"], "expected WIDTHxHEIGHT"),
        (
            ["infer", "--checkpoint", "none", "--data", "d", "--resolution", "9", "--out", "new"],
            "expected WIDTHxHEIGHT",
        ),
        (["sample", "--checkpoint", "none", "--camera", "c", "--resolution", "9", "--out", "new"], "expected WIDTHxHE"),
        (["render", "SCENE", "--checkpoint", "obpose--mixed--64x64", "--out", "a.png"], "made with other weights"),
        (["mesh", "SCENE", "--object", "1", "--out", "a.obj"], "expected a name that ends with .ply or .glb"),
        (
            ["fit-prior", "--kind", "flow", "--checkpoint", "obpose--moving--64x64", "--data", "nowhere"],
            "ships with the package, its prior too",
        ),
        (
            ["sample", "--checkpoint", MODEL, "--camera", "SCENE", "--seed", str(2**64), "--out", "new"],
            "less than 2^63",
        ),
        (
            ["add", "SCENE", "--from", "SCENE", "--object", "FIRST", "--out", "new"],
            "would not be seen; give --by or --to",
        ),
        (["paint", "SCENE"], "Unknown subcommand 'paint'"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(
    inferred: Path, tmp_path: Path, monkeypatch, capsys, command: list[str], message: str
):
    monkeypatch.chdir(tmp_path)
    before = {path: path.read_bytes() for path in inferred.iterdir()}
    places = {"SCENE": str(inferred), "FIRST": str(load_scene(inferred).ids[0])}
    for name, place in places.items():
        command = [part.replace(name, place) for part in command]
        message = message.replace(name, place)
    assert main(command) == EXIT_USAGE
    errors = capsys.readouterr().err
    assert message in errors
    assert errors.count("\n") == 1
    assert not list(tmp_path.iterdir())
    assert {path: path.read_bytes() for path in inferred.iterdir()} == before


FRAMES = ["--rgb", "nowhere", "--depth", "nowhere", "--intrinsics", "60,60,32,32"]


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["infer", "--checkpoint", MODEL], "either --data DIR, or --rgb, --depth and --intrinsics"),
        (["infer", "--checkpoint", MODEL, *FRAMES, "--data", "d"], "either --data DIR, or --rgb, --depth and --intri"),
        (["infer", "--checkpoint", MODEL, *FRAMES[:4]], "--intrinsics is missing"),
        (["infer", "--checkpoint", MODEL, *FRAMES[:4], "--intrinsics", "1"], "--intrinsics 1: expected fx,fy,cx,cy"),
        (["infer", "--checkpoint", MODEL, *FRAMES], "--rgb nowhere does not exist"),
        (["infer", "--checkpoint", MODEL, *FRAMES, "--every", "0"], "--every 0: expected 1"),
        (["infer", "--checkpoint", MODEL, "--data", "nowhere"], "nowhere"),
        (["infer", "--checkpoint", "nowhere", "--data", "d"], "--checkpoint nowhere: no such folder"),
        (["infer", "--checkpoint", MODEL, "--data", "DATA", "--scene", "9"], "--scene 9: expected"),
        (["sample", "--checkpoint", MODEL, "--camera", "SCENE", "--objects", "-1"], "--objects -1: expected 0 to"),
        (["sample", "--checkpoint", MODEL, "--camera", "nowhere"], "nowhere holds no scene"),
        (
            ["sample", "--checkpoint", MODEL, "--camera", "SCENE", "--prior", "flow"],
            "make one with obpose-edit fit-prior --kind flow, or give another --prior",
        ),
        (["render", "SCENE", "--frame", "4"], "--frame 4: expected 0 to 3"),
        (["render", "SCENE", "--resolution", "9"], "expected WIDTHxHEIGHT"),
        (["render", "nowhere"], "nowhere holds no scene"),
        (["mesh", "SCENE", "--object", "9"], "no object 9"),
        (["mesh", "SCENE", "--object", "FIRST", "--cells", "1"], "--cells 1: expected 2 to 256"),
        (["remove", "SCENE", "--object", "9"], "no object 9. Its objects are"),
        (["move", "SCENE", "--object", "FIRST"], "Give either --by or --to"),
        (["move", "SCENE", "--object", "FIRST", "--by", "0.8,0,0"], "FIRST would be outside the workspace"),
        (["rotate", "SCENE", "--object", "FIRST", "--degrees", "nan"], "--degrees nan: expected a finite number"),
        (["swap", "SCENE", "--objects", "FIRST", "9"], "no object 9"),
        (["add", "SCENE", "--object", "FIRST"], "give --by or --to"),
        (["remove", "SCENE", "--object", "FIRST", "--resolution", "9"], "expected WIDTHxHEIGHT"),
    ],
)
def test_wrong_arguments_are_named_before_the_output_that_is_there(
    inferred: Path, tiny_dataset: Path, tmp_path: Path, capsys, command: list[str], message: str
):
    ending = {"render": "/picture.png", "mesh": "/object.glb"}.get(command[0], "")
    (tmp_path / "full").mkdir()
    for name in ("picture.png", "object.glb"):
        (tmp_path / "full" / name).write_text("mine")
    places = {"SCENE": inferred, "FIRST": load_scene(inferred).ids[0], "DATA": tiny_dataset}
    for name, place in places.items():
        command = [part.replace(name, str(place)) for part in command]
        message = message.replace(name, str(place))
    assert main([*command, "--out", f"{tmp_path / 'full'}{ending}"]) == EXIT_USAGE
    errors = capsys.readouterr().err
    assert message in errors
    assert errors.count("\n") == 1
    assert "already exists" not in errors
    assert {path.read_text() for path in (tmp_path / "full").iterdir()} == {"mine"}


@pytest.mark.parametrize(
    ("command", "slow"),
    [
        (["infer", "--checkpoint", MODEL, "--data", "DATA"], "infer_scene"),
        (["sample", "--checkpoint", MODEL, "--camera", "SCENE"], "Renderer"),
        (["mesh", "SCENE", "--object", "FIRST"], "object_mesh"),
        (["render", "SCENE"], "Renderer"),
        (["remove", "SCENE", "--object", "FIRST"], "Renderer"),
    ],
)
def test_an_output_that_is_there_is_named_before_anything_slow(
    inferred: Path, tiny_dataset: Path, tmp_path: Path, capsys, monkeypatch, command: list[str], slow: str
):
    monkeypatch.setattr(edit_cli, slow, lambda *_, **__: pytest.fail(f"{slow} was called"))
    for name in ("picture.png", "object.glb"):
        (tmp_path / name).write_text("mine")
    places = {"SCENE": inferred, "FIRST": load_scene(inferred).ids[0], "DATA": tiny_dataset}
    for name, place in places.items():
        command = [part.replace(name, str(place)) for part in command]
    out = tmp_path / {"render": "picture.png", "mesh": "object.glb"}.get(command[0], ".")
    assert main([*command, "--out", str(out)]) == EXIT_USAGE
    assert "already exists" in capsys.readouterr().err


def test_a_damaged_scene_is_named(inferred: Path, tmp_path: Path, capsys):
    (tmp_path / "scene.json").write_bytes((inferred / "scene.json").read_bytes())
    (tmp_path / "scene.safetensors").write_bytes(b"something else")
    assert run("render", tmp_path, "--out", tmp_path / "a.png") != EXIT_OK
    assert "scene.safetensors is damaged" in capsys.readouterr().err
