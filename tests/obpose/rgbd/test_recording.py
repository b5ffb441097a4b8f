from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from datagen.geometry import intrinsics, pixel_rays
from datagen.rgbd.camera_file import Camera
from obpose.errors import CorruptFile, UsageError
from obpose.rgbd.recording import Recording, named_files, parse_intrinsics, read_recording

K = intrinsics(1.0, 6, 4)


def read(
    rgb: list[Path], depth: list[Path], k: np.ndarray = K, *, depth_scale: float = 0.001, **options: Any
) -> Recording:
    return read_recording(named_files(rgb, depth), Camera(k[None], depth_scale), **options)


def write_rgb(path: Path, value: int = 7, size: tuple[int, int] = (6, 4)) -> Path:
    Image.new("RGB", size, (value, 0, 0)).save(path)
    return path


def write_depth(path: Path, value: float = 1500, size: tuple[int, int] = (6, 4)) -> Path:
    array = np.full(size[::-1], value, np.float32 if path.suffix in (".npy", ".tif") else np.uint16)
    np.save(path, array) if path.suffix == ".npy" else Image.fromarray(array).save(path)
    return path


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    return write_rgb(tmp_path / "rgb.png"), write_depth(tmp_path / "depth.png")


def test_integers_are_scaled_and_floats_are_metres(tmp_path: Path, pair: tuple[Path, Path]):
    floats = [write_depth(tmp_path / name, 1.5) for name in ("d.npy", "d.tif")]
    for depth in (pair[1], *floats):
        found = read([pair[0]], [depth], K, depth_scale=0.001)
        assert (found.rgb.shape, found.depth.shape) == ((1, 4, 6, 3), (1, 4, 6))
        np.testing.assert_allclose(found.depth, 1.5, rtol=1e-6)
    assert read([pair[0]], [pair[1]], K, depth_scale=0.0001).depth[0, 0, 0] == pytest.approx(0.15)


def test_invalid_depths_are_missing(tmp_path: Path, pair: tuple[Path, Path]):
    values = np.ones((4, 6))
    values[0, :4] = [np.nan, np.inf, -1, 0]
    np.save(tmp_path / "d.npy", values)
    depth = read([pair[0]], [tmp_path / "d.npy"], K, depth_scale=1.0).depth
    assert depth[0, 0].tolist() == [0, 0, 0, 0, 1, 1]


def test_a_folder_is_read_in_the_order_of_its_numbers(tmp_path: Path):
    (tmp_path / "rgb").mkdir()
    (tmp_path / "depth").mkdir()
    for number in (10, 9, 1):
        write_rgb(tmp_path / "rgb" / f"f{number}.png", number)
        write_depth(tmp_path / "depth" / f"{number}.png", 1000 + number)
    (tmp_path / "rgb" / "notes.txt").write_text("")
    found = read([tmp_path / "rgb"], [tmp_path / "depth"], K, depth_scale=0.001)
    assert found.rgb[:, 0, 0, 0].tolist() == [1, 9, 10]
    np.testing.assert_allclose(found.depth[:, 0, 0], [1.001, 1.009, 1.01], rtol=1e-6)
    assert [path.name for path in found.files] == ["f1.png", "f9.png", "f10.png"]


def test_files_are_taken_in_the_order_given(tmp_path: Path):
    rgb = [write_rgb(tmp_path / f"{n}.png", n) for n in (2, 1)]
    depth = [write_depth(tmp_path / f"{n}.npy", n) for n in (2, 1)]
    assert read(rgb, depth, K, depth_scale=1.0).rgb[:, 0, 0, 0].tolist() == [2, 1]


def test_selected_pixels_keep_their_rays(tmp_path: Path):
    width, height = 13, 9
    k = intrinsics(1.0, width, height)
    rgb, depth = write_rgb(tmp_path / "a.png", size=(width, height)), tmp_path / "d.npy"
    np.save(depth, 1 + np.arange(width * height).reshape(height, width) / 100)
    whole = read([rgb], [depth], k, depth_scale=1.0)
    few = whole.every(3)
    rays = pixel_rays(few.k, few.depth.shape[2], few.depth.shape[1])
    np.testing.assert_allclose(rays, pixel_rays(k, width, height)[1::3, 1::3], atol=1e-12)
    np.testing.assert_array_equal(few.depth, whole.depth[:, 1::3, 1::3])
    np.testing.assert_array_equal(whole.every(1).k, k)


def cases(folder: Path) -> dict[str, tuple[list[Path], list[Path], str]]:
    """Cases by name: images, depths, and part of the message."""
    rgb, depth = write_rgb(folder / "rgb.png"), write_depth(folder / "depth.png")
    (folder / "text.png").write_text("no image")
    (folder / "text.npy").write_text("no array")
    (folder / "cut.png").write_bytes(write_rgb(folder / "whole.png").read_bytes()[:45])
    (folder / "empty").mkdir()
    np.save(folder / "cube.npy", np.ones((4, 6, 3)))
    large = (folder / "large.png", folder / "large_depth.png")
    write_rgb(large[0], size=(8, 4))
    write_depth(large[1], size=(8, 4))
    return {
        "no files": ([], [depth], "--rgb names no files"),
        "not there": ([folder / "x.png"], [depth], "x.png does not exist"),
        "depth not there": ([rgb], [folder / "x.npy"], "x.npy does not exist"),
        "no image": ([folder / "text.png"], [depth], "text.png is damaged or no image; expected PNG, JPEG, TIFF"),
        "cut short": ([folder / "cut.png"], [depth], "cut.png is damaged or no image"),
        "no array": ([rgb], [folder / "text.npy"], "text.npy is damaged or no NPY"),
        "an empty folder": ([folder / "empty"], [depth], "empty: the folder holds no .png, .jpg, .jpeg"),
        "counts": ([rgb, rgb], [depth], "names 2 images and --depth 1"),
        "sizes of frames": ([rgb, large[0]], [depth, depth], "large.png is 8x4, but .*rgb.png is 6x4"),
        "size of depth": ([rgb], [large[1]], "large_depth.png is 8x4.*depth and masks aligned"),
        "colour as depth": ([rgb], [rgb], "rgb.png holds no depth: it has mode RGB"),
        "depth as colour": ([depth], [depth], "are colour and depth swapped"),
        "a cube": ([rgb], [folder / "cube.npy"], "cube.npy holds no depth"),
        "zeros": ([rgb], [write_depth(folder / "zeros.png", 0)], "No pixel has a depth"),
        "far": (
            [rgb],
            [write_depth(folder / "far.npy", 1500)],
            "is 1.5e\\+03 m.*Floats have to be metres.*--depth-scale",
        ),
    }


def test_wrong_files_are_named(tmp_path: Path):
    for rgb, depth, message in cases(tmp_path).values():
        with pytest.raises((UsageError, CorruptFile), match=message):
            read(rgb, depth, K, depth_scale=0.001)


@pytest.mark.parametrize("value", [0.01, 60.0, 65.535, 3e38])
def test_implausible_depths_are_missing(tmp_path: Path, pair: tuple[Path, Path], value: float):
    values = np.ones((4, 6), np.float32)
    values[0, :3] = value
    np.save(tmp_path / "d.npy", values)
    found = read([pair[0]], [tmp_path / "d.npy"], K, depth_scale=1.0)
    assert found.depth[0, 0].tolist() == [0, 0, 0, 1, 1, 1]


def test_saturated_depth_is_missing_depth(tmp_path: Path, pair: tuple[Path, Path]):
    with pytest.raises(UsageError, match=r"No pixel has a depth: .* hold only zeros, negative numbers, NaN"):
        read([pair[0]], [write_depth(tmp_path / "d.png", 65535)], K, depth_scale=0.001)


def test_frames_of_two_folders_must_have_the_same_numbers(tmp_path: Path):
    for name in ("rgb", "depth"):
        (tmp_path / name).mkdir()
    for number in range(4):
        write_rgb(tmp_path / "rgb" / f"{number}.png")
        write_depth(tmp_path / "depth" / f"{number + (number > 1)}.png")
    with pytest.raises(UsageError, match=r"2\.png and .*3\.png would be one frame, but their numbers differ"):
        read([tmp_path / "rgb"], [tmp_path / "depth"], K, depth_scale=0.001)
    rgb, depth = (sorted((tmp_path / name).iterdir()) for name in ("rgb", "depth"))
    assert len(read(rgb, depth, K, depth_scale=0.001).depth) == 4


def test_a_recording_that_is_too_large_is_refused_before_pixels_are_decoded(tmp_path: Path, pair: tuple[Path, Path]):
    cut, size = tmp_path / "cut.png", 3 * 6 * 4 * 7
    cut.write_bytes(pair[0].read_bytes()[:45])
    with pytest.raises(UsageError, match=r"3 frames of 6x4 pixels need .* Give fewer frames at a time, or smaller"):
        read([cut] * 3, [pair[1]] * 3, K, depth_scale=0.001, max_bytes=size - 1)
    with pytest.raises(CorruptFile, match=r"cut\.png is damaged"):
        read([cut] * 3, [pair[1]] * 3, K, depth_scale=0.001, max_bytes=size)


def test_a_missing_folder_is_reported_before_files_are_counted(tmp_path: Path, pair: tuple[Path, Path]):
    with pytest.raises(UsageError, match=r"--depth .*nowhere does not exist"):
        read([pair[0]] * 2, [tmp_path / "nowhere"], K, depth_scale=0.001)


@pytest.mark.parametrize("text", ["500,500,320,240", "6e9,6e9,3,2", "6,1e-9,3,2", "6,6,3,-5"])
def test_intrinsics_of_images_of_another_size_are_refused(text: str, pair: tuple[Path, Path]):
    with pytest.raises(UsageError, match="cannot be those of images of 6x4"):
        read([pair[0]], [pair[1]], parse_intrinsics(text), depth_scale=0.001)


def test_the_principal_point_of_a_cropped_image_may_lie_outside(pair: tuple[Path, Path]):
    read([pair[0]], [pair[1]], parse_intrinsics("6,6,9,-2"), depth_scale=0.001)


@pytest.mark.parametrize("text", ["", "1,2,3", "1,2,3,4,5", "a,2,3,4", "0,2,3,4", "1,nan,3,4", "-1,2,3,4"])
def test_intrinsics_are_four_numbers(text: str):
    with pytest.raises(UsageError, match="--intrinsics"):
        parse_intrinsics(text)


def test_intrinsics_are_focal_lengths_and_a_centre():
    assert parse_intrinsics("500, 510,320,240").tolist() == [[500, 0, 320], [0, 510, 240], [0, 0, 1]]
