from pathlib import Path

import numpy as np
import pytest
import torch

from obpose.data.clips import ArrayClips, ClipSource, observation_of, random_view, separate_views
from obpose.data.datasets import SceneDataset
from obpose.errors import UsageError
from tests.obpose.toy import ToyClips
from tests.worlds.sphere_clips import clip_and_truth
from tests.worlds.traced import write_dataset


def test_arrays_become_what_a_model_sees():
    clip, _ = clip_and_truth(views=2)
    source = ArrayClips([clip])
    assert (len(source), source.frames_of_clip) == (1, 4)
    window = source.window(0, 1, 2)
    np.testing.assert_allclose(window["rgb"].numpy() * 255, clip.rgb[1:3], atol=1e-4)
    np.testing.assert_array_equal(window["depth"].numpy(), clip.depth[1:3])
    np.testing.assert_array_equal(window["valid"].numpy(), clip.valid[1:3])
    np.testing.assert_allclose(window["world_from_camera"].numpy(), clip.world_from_camera, rtol=1e-6)
    np.testing.assert_allclose(window["k"].numpy(), clip.k, rtol=1e-6)
    assert window["k"].dtype == window["depth"].dtype == torch.float32


def test_windows_of_a_dataset_are_cuts_of_its_clips(tmp_path: Path):
    dataset = SceneDataset(write_dataset(tmp_path / "data", scenes=1, frames=4, size=(12, 8)))
    whole = dataset.window(0, 0, 4)
    window = dataset.window(0, 2, 2)
    assert isinstance(dataset, ClipSource)
    assert dataset.frames_of_clip == 4
    for name in ("rgb", "depth", "valid"):
        assert torch.equal(window[name], whole[name][2:])


@pytest.mark.parametrize(("start", "frames"), [(-1, 2), (3, 2), (0, 0), (0, 5)])
def test_windows_outside_a_clip_are_refused(start: int, frames: int):
    with pytest.raises(UsageError, match=f"from frame {start} on is not inside a clip of 4 frames"):
        ArrayClips([clip_and_truth()[0]]).window(0, start, frames)


def test_no_clips_have_no_frames():
    with pytest.raises(UsageError, match="There are no clips; expected at least one"):
        assert ArrayClips([]).frames_of_clip


def test_labels_stay_behind():
    observation = observation_of([ToyClips(labels=True).window(index, 0, 2) for index in (0, 1)])
    assert observation.rgb.shape == (2, 2, 1, 8, 8, 3)
    assert not hasattr(observation, "segmentation")


def test_views_apart_are_scenes_in_the_order_of_clips_and_views():
    source = ArrayClips([clip_and_truth(seed, views=3)[0] for seed in (0, 1)])
    together = observation_of([source.window(index, 0, 2) for index in (0, 1)])
    apart = separate_views(together)
    assert apart.depth.shape == (6, 2, 1, 48, 64)
    for clip in (0, 1):
        for view in (0, 1, 2):
            place = 3 * clip + view
            assert torch.equal(apart.rgb[place, :, 0], together.rgb[clip, :, view])
            assert torch.equal(apart.world_from_camera[place, 0], together.world_from_camera[clip, view])


def test_one_view_of_each_clip_is_drawn_with_its_camera():
    source = ArrayClips([clip_and_truth(seed, views=3)[0] for seed in (0, 1)])
    together = observation_of([source.window(index, 0, 2) for index in (0, 1)])
    drawn = set()
    for seed in range(12):
        one = random_view(together, torch.Generator().manual_seed(seed))
        assert one.depth.shape == (2, 2, 1, 48, 64)
        for clip in (0, 1):
            (view,) = (
                v
                for v in range(3)
                if torch.equal(one.k[clip, 0], together.k[clip, v])
                and torch.equal(one.world_from_camera[clip, 0], together.world_from_camera[clip, v])
            )
            assert torch.equal(one.rgb[clip, :, 0], together.rgb[clip, :, view])
            drawn.add((clip, view))
    assert len(drawn) == 6
