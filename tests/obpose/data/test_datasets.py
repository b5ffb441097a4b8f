import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from datagen import schema
from datagen.errors import CorruptFile, UsageError
from datagen.storage import reader
from obpose.data.datasets import SceneDataset
from tests.worlds.traced import write_dataset

DEFAULT_KEYS = {"rgb", "depth", "valid", "k", "world_from_camera"}


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data") / "video", scenes=4, frames=6, size=(24, 16))


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data") / "sensor", frames=2, views=3, size=(24, 16), sensor=True)


def test_items_are_what_the_reader_reads(video: Path):
    record = reader.Dataset(video).split("val")[2]
    item = SceneDataset(video, "val")[2]
    assert item["rgb"].shape == (6, 1, 16, 24, 3)
    np.testing.assert_allclose(item["rgb"].numpy() * 255, record["rgb"], atol=1e-4)
    np.testing.assert_array_equal(item["depth"].numpy(), schema.decode_depth(record["depth"]))
    np.testing.assert_array_equal(item["k"].numpy(), record["camera/K"].astype(np.float32))
    pose = record["camera/world_from_camera"].astype(np.float32)
    np.testing.assert_array_equal(item["world_from_camera"].numpy(), pose)
    assert item["valid"].all()


def test_labels_come_only_when_asked_for(video: Path):
    assert set(SceneDataset(video)[0]) == DEFAULT_KEYS
    item = SceneDataset(video, extra=["segmentation"])[1]
    assert set(item) == {*DEFAULT_KEYS, "segmentation"}
    assert item["segmentation"].dtype == torch.int64
    truth = reader.Dataset(video).split("train")[1]["segmentation"]
    np.testing.assert_array_equal(item["segmentation"].numpy(), truth)


def test_windows_are_cuts_of_the_clip(video: Path):
    whole = SceneDataset(video)[1]["rgb"]
    first = SceneDataset(video, frames=4)[1]["rgb"]
    assert torch.equal(first, whole[:4])
    all_windows = SceneDataset(video, frames=2, window="all")
    assert len(all_windows) == 4 * 3
    assert torch.equal(all_windows[5]["rgb"], whole[4:])


def test_random_windows_follow_from_seed_epoch_and_index(video: Path):
    def windows(seed: int, epoch: int) -> list[torch.Tensor]:
        dataset = SceneDataset(video, frames=2, window="random", seed=seed)
        dataset.set_epoch(epoch)
        return [dataset[i]["rgb"] for i in reversed(range(4))]

    def differ(a: list[torch.Tensor], b: list[torch.Tensor]) -> bool:
        return any(not torch.equal(x, y) for x, y in zip(a, b, strict=True))

    torch.manual_seed(1)
    reference = windows(0, 0)
    torch.manual_seed(2)
    assert not differ(reference, windows(0, 0))
    assert differ(reference, windows(0, 1))
    assert differ(reference, windows(1, 0))


def test_random_windows_reach_every_place(video: Path):
    dataset, whole = SceneDataset(video, frames=5, window="random"), SceneDataset(video)[0]["rgb"]
    starts = set()
    for epoch in range(16):
        dataset.set_epoch(epoch)
        window = dataset[0]["rgb"]
        starts |= {start for start in range(2) if torch.equal(window, whole[start : start + 5])}
    assert starts == {0, 1}


def test_views_are_chosen(sensor: Path):
    whole, some = SceneDataset(sensor)[0], SceneDataset(sensor, views=[2, 0])[0]
    for name in ("rgb", "depth", "valid"):
        assert torch.equal(some[name], whole[name][:, [2, 0]])
    for name in ("k", "world_from_camera"):
        assert torch.equal(some[name], whole[name][[2, 0]])
    assert SceneDataset(sensor, views=1)[0]["depth"].shape == (2, 1, 16, 24)


def test_depth_is_the_sensors_where_there_is_one(sensor: Path):
    record = reader.Dataset(sensor).split("train")[0]
    observed, clean = SceneDataset(sensor)[0], SceneDataset(sensor, depth="clean", extra=["sensor_depth"])[0]
    np.testing.assert_array_equal(observed["depth"].numpy(), schema.decode_depth(record["sensor_depth"]))
    np.testing.assert_array_equal(observed["valid"].numpy(), record["sensor_valid"] > 0)
    np.testing.assert_array_equal(clean["depth"].numpy(), schema.decode_depth(record["depth"]))
    assert clean["valid"].all()
    assert torch.equal(clean["sensor_depth"], observed["depth"])


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
@pytest.mark.parametrize("start", [pytest.param("spawn", marks=pytest.mark.slow), "fork"])
def test_loader_workers_give_what_one_process_gives(video: Path, start: str):
    dataset = SceneDataset(video, frames=2, window="random")
    dataset[0]  # files open in this process must not disturb the workers
    loader = DataLoader(dataset, batch_size=2, num_workers=2, multiprocessing_context=start, persistent_workers=True)
    for epoch in (1, 2):
        dataset.set_epoch(epoch)
        batches = list(loader)
        expected = torch.stack([dataset[i]["rgb"] for i in range(4)])
        assert torch.equal(torch.cat([batch["rgb"] for batch in batches]), expected)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"split": "validation"}, "Unknown split 'validation'"),
        ({"frames": 7}, "clips of .* have 6; choose 1 to 6"),
        ({"frames": 0}, "choose 1 to 6"),
        ({"views": 2}, "have 1, counted from 0"),
        ({"views": []}, "choose among them"),
        ({"extra": ["segmentaton"]}, "did you mean 'segmentation'"),
        ({"extra": ["sensor_depth"]}, "Unknown field 'sensor_depth'"),
        ({"extra": ["objects/category"]}, "Unknown field 'objects/category'"),
        ({"extra": "segmentation"}, r"is a text; expected a list of names, such as \['segmentation'\]"),
        ({"extra": ["segmentation", "poses"]}, "Unknown field 'poses'"),
        ({"frames": -1}, "choose 1 to 6"),
        ({"frames": True}, "choose 1 to 6"),
        ({"frames": 10**12}, "choose 1 to 6"),
        ({"views": -1}, "choose among them"),
        ({"views": 0}, "choose among them"),
        ({"views": [-1]}, "choose among them"),
        ({"views": [False]}, "choose among them"),
        ({"seed": -1}, "seed=-1: expected a whole number of 0 or more"),
    ],
)
def test_impossible_requests_are_refused(video: Path, arguments: dict[str, object], message: str):
    with pytest.raises(UsageError, match=message):
        SceneDataset(video, **arguments)


def test_a_folder_without_a_dataset_is_refused(tmp_path: Path):
    with pytest.raises(UsageError, match="holds no dataset"):
        SceneDataset(tmp_path)


@pytest.mark.parametrize(("start", "frames"), [(-1, 2), (5, 2), (0, 0), (0, 7), (6, 1), (2, -1)])
def test_windows_outside_a_clip_are_refused(video: Path, start: int, frames: int):
    with pytest.raises(UsageError, match=f"from frame {start} on is not inside a clip of 6 frames"):
        SceneDataset(video).window(0, start, frames)


@pytest.mark.parametrize("index", [-1, 4])
def test_windows_of_no_scene_are_refused(video: Path, index: int):
    with pytest.raises(IndexError, match=f"Scene {index} of a split with 4 scenes"):
        SceneDataset(video).window(index, 0, 1)


def test_a_negative_epoch_is_refused(video: Path):
    with pytest.raises(UsageError, match="epoch=-1: expected a whole number of 0 or more"):
        SceneDataset(video, window="random", frames=2).set_epoch(-1)


@pytest.mark.parametrize("workers", [0, 1])
def test_damage_keeps_its_kind_through_loader_workers(video: Path, tmp_path: Path, workers: int):
    folder = tmp_path / "damaged"
    shutil.copytree(video, folder)
    (folder / "train-00000.h5").write_bytes(b"other")
    loader = DataLoader(SceneDataset(folder), num_workers=workers, multiprocessing_context="spawn" if workers else None)
    with pytest.raises(CorruptFile, match=r"train-00000\.h5"):
        next(iter(loader))


def test_an_item_beyond_the_end_is_refused(video: Path):
    with pytest.raises(IndexError, match="Item 4 of a dataset with 4 items"):
        SceneDataset(video)[4]
