from pathlib import Path

from datagen.formats.scenes import UNKNOWN_CATEGORY, scenes_of
from datagen.storage.reader import Dataset
from tests.datagen.formats.conftest import source


def test_objects_have_no_padding(clips: Path):
    scene = source(clips, 1)
    assert scene.objects == 2
    assert scene.categories == ["box", "cylinder"]
    assert scene.per_object("poses/position", axis=1).shape == (3, 2, 3)


def test_objects_without_a_table_are_counted_by_their_ids(clips: Path):
    scene = source(clips)
    scene._fields -= {"objects/count", "objects/category"}
    assert scene.objects == 3
    assert scene.categories == 3 * [UNKNOWN_CATEGORY]


def test_files_are_closed_after_their_scenes(clips: Path):
    scenes = Dataset(clips).split("train")
    assert [scene.frames for scene in scenes_of(scenes)] == [3, 3]
    assert not scenes._shards
