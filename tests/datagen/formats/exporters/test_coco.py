import json
from pathlib import Path

import numpy as np
import pytest
from imageio.v3 import imread

from datagen.catalog import CATEGORIES
from tests.datagen.formats.conftest import Export, source

coco_library = pytest.importorskip("pycocotools.coco")
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation")  # of pycocotools


@pytest.mark.parametrize(("dataset", "images"), [("clips", 6), ("stills", 2)])
def test_pycocotools_reads_every_mask_and_box(
    dataset: str, images: int, exported: Export, request: pytest.FixtureRequest
):
    data = request.getfixturevalue(dataset)
    folder = exported(data, "coco")
    coco = coco_library.COCO(folder / "annotations" / "instances_train.json")
    assert len(coco.imgs) == images
    for image in coco.imgs.values():
        video, frame = divmod(image["id"] - 1, source(data).frames)
        index, view = divmod(video, source(data).views)
        scene = source(data, index)
        assert (image["video_id"], image["frame_index"]) == (video + 1, frame)
        np.testing.assert_array_equal(imread(folder / "train" / image["file_name"]), scene.rgb[frame, view])
        labels = np.zeros_like(scene.segmentation[frame, view])
        assert (image["height"], image["width"]) == labels.shape
        for annotation in coco.loadAnns(coco.getAnnIds(imgIds=image["id"])):
            mask = coco.annToMask(annotation) > 0
            labels[mask] = annotation["instance_id"]
            rows, columns = np.nonzero(mask)
            corner, sides = (columns.min(), rows.min()), (np.ptp(columns) + 1, np.ptp(rows) + 1)
            assert annotation["bbox"] == [*corner, *sides]
            assert annotation["area"] == len(rows)
            name = coco.cats[annotation["category_id"]]["name"]
            assert name == scene.categories[annotation["instance_id"] - 1]
        np.testing.assert_array_equal(labels, scene.segmentation[frame, view])


def test_video_annotations_follow_each_object(clips: Path, exported: Export):
    values = json.loads((exported(clips, "coco") / "annotations" / "videos_train.json").read_text())
    assert [video["length"] for video in values["videos"]] == [3, 3]
    assert [track["video_id"] for track in values["annotations"]] == [1, 1, 1, 2, 2]
    track, scene = values["annotations"][1], source(clips)
    for frame in range(3):
        mask = scene.segmentation[frame, 0] == track["instance_id"]
        runs = np.repeat(
            np.arange(len(track["segmentations"][frame]["counts"])) % 2, track["segmentations"][frame]["counts"]
        )
        np.testing.assert_array_equal(runs.reshape(mask.shape[::-1]).T, mask)
        assert track["areas"][frame] == np.count_nonzero(mask)
        left, top, width, height = track["bboxes"][frame]
        assert np.count_nonzero(mask[top : top + height, left : left + width]) == np.count_nonzero(mask)


def test_stills_have_no_video_annotations(stills: Path, exported: Export):
    folder = exported(stills, "coco")
    assert [path.name for path in (folder / "annotations").iterdir()] == ["instances_train.json"]
    assert sorted(path.name for path in (folder / "train").iterdir()) == ["000000-0", "000000-1"]


def test_ids_of_categories_do_not_depend_on_the_scenes(clips: Path, exported: Export):
    values = json.loads((exported(clips, "coco") / "annotations" / "instances_train.json").read_text())
    assert [each["name"] for each in values["categories"]][: len(CATEGORIES)] == list(CATEGORIES)
