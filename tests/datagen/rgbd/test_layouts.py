"""Two frames of a moving camera, written in every layout: the same pixels, depths and poses come back."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datagen.errors import CorruptFile, UsageError
from datagen.rgbd.camera_file import read_camera
from datagen.rgbd.files import read_ids
from datagen.rgbd.images import read_colour
from datagen.rgbd.layouts import FrameFiles, find_frames
from tests.worlds.recordings import CAMERAS, Shot, camera_json, save, shoot, units, write_json, write_rgbd

SHOTS = [shoot(position) for position in CAMERAS[:2]]
POSES = [shot.pose.tolist() for shot in SHOTS]


def folders(place: Path) -> Path:
    write_rgbd(place, SHOTS)
    for number, shot in enumerate(SHOTS):
        (place / "poses").mkdir(exist_ok=True)
        np.savetxt(place / "poses" / f"{number}.txt", shot.pose)
    return place


def mixed(place: Path, name: str = "{number:06d}-{word}") -> Path:
    for number, shot in enumerate(SHOTS):
        for word, image in (("color", shot.rgb), ("depth", units(shot.depth, 1e-4)), ("label", shot.ids)):
            save(place / f"{name.format(number=number, word=word)}.png", image)
    write_json(place / "camera.json", camera_json(SHOTS[0], world_from_camera=POSES))
    return place


def words_first(place: Path) -> Path:
    return mixed(place, "{word}_{number}")


def tum(place: Path) -> Path:
    """Colour at 10.0 and 10.1 seconds; depth and poses a little later, and a colour image without depth at 10.3."""
    lists: dict[str, list[str]] = {"rgb": [], "depth": [], "groundtruth": []}
    for number, shot in enumerate([*SHOTS, SHOTS[0]]):
        time, later = (1.3e9 + 10 + 0.1 * number + late for late in (0.0, 0.02))
        save(place / f"rgb/{time:.6f}.png", shot.rgb)
        lists["rgb"].append(f"{time:.6f} rgb/{time:.6f}.png")
        pose = [*shot.pose[:3, 3], *Rotation.from_matrix(shot.pose[:3, :3]).as_quat()]
        lists["groundtruth"].append(f"{later:.6f} {' '.join(map(str, pose))}")
        if number < 2:
            save(place / f"depth/{later:.6f}.png", units(shot.depth, 1e-4))
            lists["depth"].append(f"{later:.6f} depth/{later:.6f}.png")
    for name, rows in lists.items():
        (place / f"{name}.txt").write_text("\n".join(["# a comment", *rows]) + "\n")
    write_json(place / "camera.json", camera_json(SHOTS[0]))
    return place


def stamped(place: Path) -> Path:
    tum(place)
    for name in ("rgb", "depth", "groundtruth"):
        (place / f"{name}.txt").unlink()
    write_json(place / "camera.json", camera_json(SHOTS[0], world_from_camera=POSES))
    return place


def arrays(place: Path, **changes: np.ndarray) -> Path:
    place.mkdir()
    stacks = {
        "rgb": np.stack([shot.rgb for shot in SHOTS]),
        "depth": np.stack([shot.depth for shot in SHOTS])[..., None],
        "masks": np.stack([shot.ids for shot in SHOTS]),
        "K": SHOTS[0].k,
        "pixel_center": np.float64(0.5),
        "world_from_camera": np.array(POSES),
    }
    np.savez(place / "frames.npz", **{**stacks, **changes})
    return place / "frames.npz"


def exr(place: Path) -> Path:
    openexr = pytest.importorskip("OpenEXR")
    folders(place)
    for number, shot in enumerate(SHOTS):
        (place / "depth" / f"{number}.png").unlink()
        header = {"compression": openexr.ZIP_COMPRESSION, "type": openexr.scanlineimage}
        openexr.File(header, {"Z": shot.depth.astype(np.float32)}).write(str(place / "depth" / f"{number}.exr"))
    return place


def found(place: Path) -> FrameFiles:
    frames = find_frames(place)
    assert frames is not None
    return frames


def check(frames: FrameFiles, shots: list[Shot]) -> None:
    assert len(frames.colour) == len(frames.depth) == len(shots)
    assert frames.camera is not None
    camera = read_camera(frames.camera, default_scale=frames.depth_scale)
    np.testing.assert_allclose(camera.k(), shots[0].k)
    for number, shot in enumerate(shots):
        assert np.array_equal(read_colour(frames.colour[number]), shot.rgb)
        np.testing.assert_allclose(camera.depth(frames.depth[number]), shot.depth, atol=1e-4)
        np.testing.assert_allclose(frames.pose(number, camera), shot.pose, atol=1e-6)
        assert not frames.masks or np.array_equal(read_ids(frames.masks[number]), shot.ids)


@pytest.mark.parametrize("write", [folders, mixed, words_first, tum, stamped, arrays, exr])
def test_every_layout_gives_the_same_frames(write: Callable[[Path], Path], tmp_path: Path):
    frames = found(write(tmp_path / "a"))
    check(frames, SHOTS)
    assert bool(frames.masks) == (write not in (tum, stamped))
    assert frames.left_out == (write in (tum, stamped))


def stamped_with_a_gap(place: Path) -> Path:
    """Three colour images named by their times, the second without depth, and a pose for each in camera.json."""
    for number, shot in enumerate((SHOTS[0], SHOTS[0], SHOTS[1])):
        save(place / f"rgb/{1.3e9 + number:.1f}.png", shot.rgb)
        if number != 1:
            save(place / f"depth/{1.3e9 + number:.1f}.png", units(shot.depth, 1e-4))
    poses = [POSES[0], np.eye(4).tolist(), POSES[1]]
    write_json(place / "camera.json", camera_json(SHOTS[0], world_from_camera=poses))
    return place


def listed_with_a_gap(place: Path) -> Path:
    stamped_with_a_gap(place)
    for name in ("rgb", "depth"):
        rows = [f"{path.stem} {name}/{path.name}" for path in sorted((place / name).iterdir())]
        (place / f"{name}.txt").write_text("\n".join(rows))
    return place


@pytest.mark.parametrize("write", [stamped_with_a_gap, listed_with_a_gap])
def test_poses_belong_to_the_images_that_were_kept(write: Callable[[Path], Path], tmp_path: Path):
    check(found(write(tmp_path / "a")), SHOTS)


def test_more_poses_than_images_are_refused(tmp_path: Path):
    place = mixed(tmp_path / "a")
    write_json(place / "camera.json", camera_json(SHOTS[0], world_from_camera=[*POSES, POSES[0]]))
    with pytest.raises(UsageError, match="world_from_camera holds 3 poses for 2 images"):
        check(found(place), SHOTS)


def test_masks_of_a_mixed_folder_of_times_are_paired(tmp_path: Path):
    for number, shot in enumerate(SHOTS):
        images = {"color": shot.rgb, "depth": units(shot.depth, 1e-4), "mask": shot.ids}
        for place, (word, image) in enumerate(images.items()):
            save(tmp_path / "a" / f"{1.3e9 + number + 0.01 * place:.2f}_{word}.png", image)
    write_json(tmp_path / "a" / "camera.json", camera_json(SHOTS[0], world_from_camera=POSES))
    frames = found(tmp_path / "a")
    check(frames, SHOTS)
    assert len(frames.masks) == 2


def test_a_single_frame_needs_no_number(tmp_path: Path):
    shot = SHOTS[0]
    place = arrays(tmp_path / "a", rgb=shot.rgb, depth=shot.depth, masks=shot.ids, world_from_camera=shot.pose)
    check(found(place), SHOTS[:1])
    save(tmp_path / "b/color.png", shot.rgb)
    save(tmp_path / "b/depth.png", units(shot.depth, 1e-4))
    write_json(tmp_path / "camera.json", camera_json(shot, world_from_camera=POSES[0]))  # in the folder above
    check(found(tmp_path / "b"), SHOTS[:1])


def test_folders_without_colour_hold_no_frames(tmp_path: Path):
    save(tmp_path / "depth.png", units(SHOTS[0].depth, 1e-4))
    assert find_frames(tmp_path) is None
    assert find_frames(tmp_path / "nowhere") is None


def remove(name: str) -> Callable[[Path], object]:
    return lambda place: (place / name).unlink()


@pytest.mark.parametrize(
    ("write", "spoil", "message"),
    [
        (mixed, remove("000001-depth.png"), "000001-color.png has no depth image beside it"),
        (mixed, remove("000001-label.png"), "000001-color.png has no mask beside it"),
        (folders, remove("depth/1.png"), "2 colour images but 1 depth images"),
        (tum, lambda place: (place / "depth.txt").write_text("7 depth/a.png\n"), "no image of rgb.txt has a depth"),
        (tum, lambda place: (place / "rgb.txt").write_text("a b\n"), "expected rows of 2 columns, a time first"),
        (tum, lambda place: (place / "rgb.txt").write_text("nan b\n"), "expected rows of 2 columns, a time first"),
        (mixed, lambda place: save(place / "000001_rgb.png", SHOTS[0].rgb), "would be the same colour image"),
        (tum, lambda place: (place / "groundtruth.txt").write_text("1300000010.02 1 2 3 0 0 0 0\n"), "holds no pose"),
    ],
)
def test_incomplete_recordings_are_refused(write, spoil: Callable[[Path], object], message: str, tmp_path: Path):
    write(tmp_path / "a")
    spoil(tmp_path / "a")
    with pytest.raises((UsageError, CorruptFile), match=message):
        find_frames(tmp_path / "a")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"depth": np.ones((3, 36, 48))}, "rgb has 2 frames, depth another number"),
        ({"world_from_camera": np.ones((2, 4, 4))}, "holds no rigid pose"),
        ({"world_from_camera": np.tile(np.eye(4), (3, 1, 1))}, "or one for each frame"),
        ({"world_from_camera": np.float64(1)}, "or one for each frame"),
        ({"world_from_camera": np.full((4, 4), "1")}, "expected numbers"),
    ],
)
def test_arrays_that_do_not_belong_together_are_refused(changes: dict, message: str, tmp_path: Path):
    with pytest.raises((UsageError, CorruptFile), match=message):
        find_frames(arrays(tmp_path / "a", **changes))


def test_an_exr_image_of_colours_or_a_damaged_one_is_no_depth(tmp_path: Path):
    place = exr(tmp_path / "a")
    import OpenEXR

    def write(path: Path, channels: dict[str, np.ndarray]) -> None:
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, channels).write(str(path))

    depth = SHOTS[0].depth.astype(np.float32)
    camera, path = read_camera(place / "camera.json"), place / "depth" / "0.exr"
    half = path.read_bytes()[: path.stat().st_size // 2]
    for spoil, message in (
        (lambda: write(path, {"A": depth, "B": depth}), "has the channels A, B; expected depth in one"),
        (lambda: write(path, {"RGB": np.stack([depth, depth, 2 * depth], axis=-1)}), "holds colours"),
        (lambda: path.write_bytes(b"no image"), "damaged or no EXR image"),
        (lambda: path.write_bytes(half), "damaged or no EXR image"),
    ):
        spoil()
        with pytest.raises(CorruptFile, match=message):
            camera.depth(path)
    write(path, {"RGB": np.stack([depth] * 3, axis=-1)})
    np.testing.assert_array_equal(camera.depth(path), depth)
