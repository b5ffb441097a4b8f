from pathlib import Path

import pytest

from datagen.config import load_recipe
from datagen.errors import DatagenError, UsageError
from datagen.storage.reader import Dataset
from datagen.tracks import DataFolder, Track, all_tracks, find_dataset, find_track, find_tracks
from tests.worlds.traced import write_dataset

NAMES = [
    "moving",
    "touching",
    "same-colour",
    "two-colour",
    "textured",
    "noisy",
    "mixed",
    "static",
    "clevr3d",
    "multishape",
]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path))
    return tmp_path


class TinyTrack(Track):
    def size(self, split: str) -> int:
        return {"train": 2, "val": 1, "test": 1}[split]


@pytest.fixture
def tiny(cache: Path) -> Track:
    pytest.importorskip("pybullet", reason="simulation needs PyBullet")
    return TinyTrack("moving")


def test_every_recipe_is_a_track():
    assert {track.name for track in all_tracks()} == {*NAMES, "cluttered", "desk"}


@pytest.mark.parametrize("name", [*NAMES, "desk"])
def test_slots_are_the_most_objects_and_the_background(name: str):
    recipe = load_recipe(name)
    maxima = [recipe.for_scene(index).objects.maximum for index in range(max(1, len(recipe.parts)))]
    assert find_track(name).slots == max(maxima) + 1


def test_sizes_of_images():
    sizes = {name: find_track(name).resolution for name in NAMES}
    assert sizes.pop("clevr3d") == sizes.pop("multishape") == (80, 60)
    assert set(sizes.values()) == {(64, 64)}


def test_images_for_a_gpu_are_larger_and_another_dataset():
    assert [find_track(name, "gpu").resolution for name in ("moving", "clevr3d")] == [(128, 128), (128, 96)]
    small, large = find_track("moving"), find_track("moving", "gpu")
    assert small.spec_hash != large.spec_hash
    assert small.folder != large.folder
    assert small == Track("moving", "cpu")


def test_a_group_stands_for_its_tracks():
    assert find_tracks(["paper", "moving", "mixed"]) == [
        find_track(name) for name in ("moving", "static", "clevr3d", "multishape", "mixed")
    ]
    assert {track.profile for track in find_tracks(["paper"], "gpu")} == {"gpu"}
    with pytest.raises(UsageError, match="did you mean 'paper'"):
        find_tracks(["papr"])


def test_an_unknown_track_gets_the_nearest():
    with pytest.raises(UsageError, match="'paper' is a group of tracks; expected one of its members: moving, static"):
        find_track("paper")
    with pytest.raises(UsageError, match="Unknown track 'movin'; did you mean 'moving'"):
        find_track("movin")


def test_a_track_is_made_split_by_split_and_only_once(tiny: Track):
    folder = tiny.prepare(("val", "test"))
    dataset = Dataset(folder)
    assert dataset.spec["spec_hash"] == tiny.spec_hash
    assert dataset.spec["resolution"] == [64, 64]
    assert (tiny.missing(["val", "test"]), tiny.missing(["train"])) == (0, 2)
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    assert tiny.prepare(("val", "test")) == folder
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == before
    tiny.prepare(("train", "val", "test"))
    Dataset(folder).check_complete()
    assert Dataset(folder).spec["spec_hash"] == tiny.spec_hash


def test_other_settings_of_a_recipe_have_another_folder(cache: Path):
    folders = {track("moving").folder for track in (Track, TinyTrack)}
    assert len(folders) == 2
    assert {folder.parent for folder in folders} == {cache / "tracks"}


def test_a_dataset_in_the_place_of_a_track(tmp_path: Path):
    source = DataFolder(write_dataset(tmp_path / "mine", scenes=2))
    assert (source.name, source.slots, source.size("test")) == ("mine", 5, 2)
    assert source.prepare(("val", "test")) == tmp_path / "mine"
    (tmp_path / "mine" / "val-00000.h5").unlink()
    with pytest.raises(DatagenError, match="2 scenes missing"):
        source.prepare(("val", "test"))


def test_a_dataset_is_found_by_its_identity(cache: Path, tmp_path: Path):
    one, two = write_dataset(tmp_path / "one", scenes=1), write_dataset(tmp_path / "two", scenes=2)
    wanted = Dataset(two).spec["spec_hash"]
    assert find_dataset("moving", wanted, [tmp_path / "gone", one, two]) == two
    assert find_dataset("other", wanted, [one]) is None
