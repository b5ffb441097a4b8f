from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.models.adapters import own_frames
from benchmark.models.adapters.learned import LearnedSegmenter
from benchmark.models.adapters.own_frames import segment_table, table_segmenter
from benchmark.models.classical import CLASSICAL
from benchmark.models.interface import Clip
from datagen.errors import UsageError
from obpose.commands.segment import OBJECTS
from obpose.data.clips import ArrayClips
from obpose.data.scene_stats import measure_scene
from obpose.model.build import build_obpose
from obpose.rgbd.frame_arguments import Frames
from obpose.rgbd.frames import prepare
from obpose.rgbd.recording import Recording
from obpose.rgbd.segment import segment_frames
from obpose.rgbd.weights import method_of
from obpose.storage.checkpoint import save_model
from obpose.systems import find_system
from tests.worlds.sphere_clips import clip_and_truth

COMPONENTS = CLASSICAL["plane-components"].build({"slots": 3})


@pytest.fixture(scope="module")
def clip() -> Clip:
    return clip_and_truth(frames=1, resolution=(48, 36))[0]


@pytest.fixture
def weights(clip: Clip, tmp_path: Path) -> Path:
    """An untrained model with two slots that finds objects everywhere."""
    system = find_system("obpose")
    measures = system.known(measure_scene(ArrayClips([clip])).changes())
    config = system.config("cpu", {"model.slots": 2, **measures})
    torch.manual_seed(0)
    model = build_obpose(config)
    with torch.no_grad():
        model.heads.prescope[-1].bias.copy_(torch.tensor([0.0, 5.0]))
    save_model(tmp_path / "model", model.state_dict(), config, {})
    return tmp_path / "model"


def test_weights_look_for_as_many_objects_as_the_command_does(clip: Clip, weights: Path):
    segmenter = LearnedSegmenter("obpose", slots=3, checkpoint=weights)
    segmenter.fit([], [], seed=0, budget=0.0)
    before = segmenter.segment(clip).labels
    found = table_segmenter(segmenter)(clip).labels
    method, trained = method_of(weights, OBJECTS)
    pose = clip.world_from_camera.astype(np.float64)
    recording = Recording((Path(),), clip.rgb[:, 0], clip.depth[:, 0], clip.k[0], pose)
    np.testing.assert_array_equal(found[:, 0], segment_frames(prepare(recording, Frames(), trained), method))
    assert found.max() > 2
    np.testing.assert_array_equal(segmenter.segment(clip).labels, before)


def test_only_a_missing_table_makes_everything_background(clip: Clip, monkeypatch: pytest.MonkeyPatch):
    assert segment_table(COMPONENTS, clip).labels.any()
    noise = np.random.default_rng(0).uniform(0.8, 3.0, clip.depth.shape).astype(np.float32)
    assert not segment_table(COMPONENTS, replace(clip, depth=noise)).labels.any()

    def wrong(*_: object):
        raise UsageError("another error")

    monkeypatch.setattr(own_frames, "prepare", wrong)
    with pytest.raises(UsageError, match="another error"):
        segment_table(COMPONENTS, clip)
