from pathlib import Path

import numpy as np
import pytest

from benchmark.tasks.editing.truth import kinds_in
from datagen.errors import UsageError
from datagen.schema import EDITS, decode_depth
from datagen.storage.reader import Dataset
from tests.benchmark.tasks.editing import oracle
from tests.worlds import generated
from tests.worlds.imported import import_balls


def test_pairs_hold_what_the_dataset_holds(edits: Path):
    record, truth = oracle.scenes_of(edits)[0], oracle.truth_of(edits)
    assert truth.frames == (0, 1, 2)
    np.testing.assert_array_equal(truth.labels, record["segmentation"])
    assert [pair.kind for pair in truth.pairs] == list(EDITS)
    for pair in truth.pairs:
        assert pair.object == record[f"edits/{pair.kind}/object"] > 0
        np.testing.assert_array_equal(np.rint(255 * pair.after.rgb), record[f"edits/{pair.kind}/rgb"])
        np.testing.assert_array_equal(pair.before.depth, decode_depth(record["depth"]))
    np.testing.assert_array_equal(truth.pairs[0].transform, np.eye(4))
    np.testing.assert_array_equal(truth.pairs[1].transform, record["edits/move/transform"])


def test_regions_cover_every_pixel_once(edits: Path):
    for pair in oracle.truth_of(edits).pairs:
        assert np.all(pair.inside.astype(int) + pair.shadow + pair.outside == 1)
        assert pair.inside.any()


def test_inside_a_removal_is_the_object_and_inside_a_copy_is_the_copy(edits: Path):
    remove, _, add = oracle.truth_of(edits).pairs
    np.testing.assert_array_equal(remove.inside, remove.before.labels == remove.object)
    np.testing.assert_array_equal(add.inside, add.after.labels == add.before.labels.max() + 1)


def test_a_dataset_without_edits_is_told_how_to_get_some(tmp_path: Path):
    generated.make(tmp_path / "plain", {"test": 1})
    with pytest.raises(UsageError, match=r"obpose-datagen render --from .*plain --edits remove,move,add"):
        kinds_in(Dataset(tmp_path / "plain"))


def test_an_imported_dataset_has_no_edits(tmp_path: Path):
    with pytest.raises(UsageError, match="was imported and holds no edits"):
        kinds_in(import_balls(tmp_path))
