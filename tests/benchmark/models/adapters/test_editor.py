from pathlib import Path

import numpy as np
import pytest

from benchmark.clips import ClipSequence
from benchmark.models.adapters.editor import SceneEditor
from benchmark.models.editor_interface import EditableScene, Editor
from datagen.storage.reader import Dataset

IDENTITY = np.eye(4)


@pytest.fixture(scope="module")
def scene(tiny_dataset: Path) -> EditableScene:
    editor = SceneEditor(Path("obpose--moving--64x64"))
    assert isinstance(editor, Editor)
    return editor.infer(ClipSequence(Dataset(tiny_dataset).split("test"))[0])


def label_of(scene: EditableScene) -> int:
    return int(np.unique(scene.labels[scene.labels > 0])[0])


def test_pictures_have_the_frames_that_are_asked_for_and_labels_of_the_segmentation(scene: EditableScene):
    picture = scene.render([0, 3])
    assert picture.rgb.shape == (2, 1, 64, 64, 3)
    assert picture.depth.shape == picture.labels.shape == (2, 1, 64, 64)
    assert scene.labels.shape == (4, 1, 64, 64)
    np.testing.assert_array_equal(scene.render([3]).rgb[0], picture.rgb[1])


def test_the_identity_changes_nothing_and_a_step_and_a_removal_do(scene: EditableScene):
    label, before = label_of(scene), scene.render([0])
    same = scene.edited("move", label, IDENTITY, [0])
    np.testing.assert_allclose(same.rgb, before.rgb, atol=1e-5)
    step = IDENTITY.copy()
    step[0, 3] = 0.1
    assert np.abs(scene.edited("move", label, step, [0]).depth - before.depth).max() > 1e-3
    assert not np.any(scene.edited("remove", label, IDENTITY, [0]).labels == label)


def test_a_copy_has_a_label_of_its_own(scene: EditableScene):
    step = IDENTITY.copy()
    step[0, 3] = 0.1
    before, after = scene.render([0]).labels, scene.edited("add", label_of(scene), step, [0]).labels
    assert set(np.unique(after)) - set(np.unique(before)) == {scene.labels.max() + 1}
