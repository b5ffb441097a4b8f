import os
from pathlib import Path

import pytest

from datagen.errors import UsageError
from datagen.rgbd import frame_files
from datagen.rgbd.frame_files import check_pairs, list_frames, nearest_times, pair_masks, sort_frames


def files(names: str, folder: str = "") -> list[Path]:
    return [Path(folder, f"{name}.png") for name in names.split()]


@pytest.mark.parametrize(
    "names",
    [
        "1 2 10",
        "0.25 0.5 0.75 1.0 1.125",
        "1305031102.175304 1305031102.5 1305031102.75 1305031103.0",
        "-10 -2 -0.5 0 0.25 3",
        "t_-1.5 t_-1 t_0 t_2",
        "1e-05 0.0001 0.02 1.5e+01 100",
        "0001 002 3 0010",
        "frame-1 frame-2 frame-10",
        "run--1 run--2 run--10",
        "2024-01-05 2024-01-10 2024-02-01",
        "2024.1.5 2024.1.10 2024.2.1",
        "frame0.color frame2.color frame10.color",
        "0.25.depth 0.5.depth 10.depth",
        "take1.1 take1.2 take1.9 take1.10",
        "a2 A10 b1",
        "a a1 a1b a2 b",
        "x² x³ ²",
    ],
)
def test_numbers_in_names_give_the_order(names: str):
    expected = files(names)
    assert sort_frames(expected[::-1]) == expected
    assert sort_frames(sorted(expected)) == expected


def test_equal_numbers_are_in_the_order_of_their_names():
    assert sort_frames(files("1 01 001")) == files("001 01 1")


def test_system_files_and_folders_are_not_frames(tmp_path: Path):
    for name in ("0.png", "1.PNG", "._0.png", ".1.png", ".DS_Store", "Thumbs.db", "desktop.ini", "0.png~", "a.txt"):
        (tmp_path / name).touch()
    for name in ("2.png", "__MACOSX"):
        (tmp_path / name).mkdir()
    assert [path.name for path in list_frames([tmp_path], [".png"], "--rgb")] == ["0.png", "1.PNG"]


def test_a_folder_with_nothing_but_hidden_files_holds_no_frames(tmp_path: Path):
    (tmp_path / "._0.png").touch()
    with pytest.raises(UsageError, match=r"--depth .*: the folder holds no \.png, \.npy"):
        list_frames([tmp_path], [".png", ".npy"], "--depth")


def test_a_frame_that_is_a_broken_link_is_named(tmp_path: Path):
    (tmp_path / "0.png").touch()
    (tmp_path / "1.png").symlink_to(tmp_path / "gone.png")
    with pytest.raises(UsageError, match=r"1\.png does not exist, it is a broken link"):
        list_frames([tmp_path], [".png"], "--rgb")


def test_a_pipe_is_not_skipped_silently(tmp_path: Path):
    os.mkfifo(tmp_path / "0.png")
    assert list_frames([tmp_path], [".png"], "--rgb") == [tmp_path / "0.png"]


@pytest.mark.parametrize(
    ("colours", "depths"),
    [
        ("1 2 3", "1 2 3"),
        ("frame1.color frame2.color", "1 2"),
        ("0001 0002", "1 2"),
        ("1.25 2.5", "1.26 2.49"),
        ("cam0_1 cam0_2", "cam1_1 cam1_2"),
        ("a b", "c d"),
        ("1 2 3 4 5", "5 6 7 8 9"),
    ],
)
def test_matching_pairs_are_accepted(colours: str, depths: str):
    check_pairs(files(colours, "rgb"), files(depths, "depth"))


def test_names_are_looked_through_once_for_each_folder(monkeypatch: pytest.MonkeyPatch):
    looked: list[int] = []
    splitter = frame_files._splitter
    monkeypatch.setattr(frame_files, "_splitter", lambda paths: looked.append(len(paths)) or splitter(paths))
    names = files(" ".join(map(str, range(50))))
    check_pairs(names, names)
    assert looked == [50, 50]


@pytest.mark.parametrize(
    ("colours", "depths", "said"),
    [
        ("1 2 3 4", "1 2 4 5", "rgb/3.png and depth/4.png would be one frame"),
        ("0 1 2", "1 2 3", "rgb/0.png and depth/1.png would be one frame"),
        ("0.25 0.5 0.75", "0.25 0.75 1.0", "rgb/0.5.png and depth/0.75.png"),
    ],
)
def test_pairs_of_different_frames_are_refused(colours: str, depths: str, said: str):
    with pytest.raises(UsageError, match=said):
        check_pairs(files(colours, "rgb"), files(depths, "depth"))


@pytest.mark.parametrize(
    ("colours", "masks"),
    [
        ("1 2", "1 2"),
        ("0001 0002", "1_mask 2_mask"),
        ("cup fork", "cup-mask fork"),
        ("photo", "labels"),
        ("1700000000.1 1700000001.1", "1700000000.2 1700000001.2"),
    ],
)
def test_masks_with_the_names_of_their_images_are_paired(colours: str, masks: str):
    assert pair_masks(files(colours, "rgb"), files(masks, "masks"), Path()) == files(masks, "masks")


@pytest.mark.parametrize(("colours", "masks"), [("1 2", "11 12"), ("1 2", "a b"), ("cup fork", "one two")])
def test_masks_with_other_names_are_refused(colours: str, masks: str):
    with pytest.raises(UsageError, match="their names do not agree"):
        pair_masks(files(colours, "rgb"), files(masks, "masks"), Path())


def test_a_time_has_one_partner():
    assert nearest_times([0.0, 1.0, 1.2, 2.2], [1.1999]) == [None, None, 0, None]
    assert nearest_times([0.0, 1.0, 1.2, 2.2], [1.01]) == [None, 0, None, None]
