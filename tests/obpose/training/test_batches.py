import itertools
import multiprocessing
import os

import pytest
import torch

from obpose.errors import CorruptFile
from obpose.training.batches import Sampling, Share, batches, readers_for
from tests.obpose.toy import ToyClips

SAMPLING = Sampling(clips=5, frames_of_clip=4, frames=2, batch=2, seed=3)


def test_windows_follow_from_seed_and_step():
    one = [SAMPLING.windows(step) for step in range(10)]
    other = [SAMPLING.windows(step) for step in reversed(range(10))]
    assert one == other[::-1]
    another = Sampling(clips=5, frames_of_clip=4, frames=2, batch=2, seed=4)
    assert one != [another.windows(step) for step in range(10)]


def test_every_clip_comes_once_before_any_comes_again():
    clips = [window.clip for step in range(50) for window in SAMPLING.windows(step)]
    epochs = [tuple(clips[i : i + 5]) for i in range(0, 100, 5)]
    assert all(sorted(epoch) == [0, 1, 2, 3, 4] for epoch in epochs)
    assert len(set(epochs)) > 10


def test_every_place_in_a_clip_is_reached_and_none_beyond():
    windows = [window for step in range(50) for window in SAMPLING.windows(step)]
    assert {window.start for window in windows} == {0, 1, 2}
    assert {window.frames for window in windows} == {2}


def test_processes_share_the_batch_of_one():
    whole = Sampling(clips=5, frames_of_clip=4, frames=2, batch=4, seed=0).windows(7)
    parts = [Share(process, 2).of(whole) for process in range(2)]
    assert list(itertools.chain(*parts)) == whole
    assert [len(part) for part in parts] == [2, 2]


class DamagedClips(ToyClips):
    """The third clip cannot be read."""

    def window(self, index: int, start: int, frames: int) -> dict[str, torch.Tensor]:
        if index == 2:
            raise CorruptFile("train-00000.h5 is damaged")
        return super().window(index, start, frames)


@pytest.mark.parametrize("readers", [0, 1])
def test_damage_is_one_line_wherever_it_was_read(readers: int):
    with pytest.raises(CorruptFile) as caught:
        for _ in itertools.islice(batches(DamagedClips(), SAMPLING, Share(), first_step=0, readers=readers), 3):
            pass
    assert str(caught.value) == "train-00000.h5 is damaged"


@pytest.mark.slow
def test_readers_change_nothing():
    here, elsewhere = (
        [batch["rgb"] for batch in itertools.islice(batches(ToyClips(), SAMPLING, Share(), first_step=4, readers=n), 6)]
        for n in (0, 2)
    )
    assert all(torch.equal(one, other) for one, other in zip(here, elsewhere, strict=True))


@pytest.mark.slow
def test_signals_to_the_group_reach_no_reader():
    others = multiprocessing.active_children()  # of tests before
    feed = batches(ToyClips(), SAMPLING, Share(), first_step=4, readers=2)
    # The second batch is the second reader's.
    next(feed), next(feed)
    groups = [os.getpgid(child.pid) for child in multiprocessing.active_children() if child.pid and child not in others]
    assert len(groups) == 2
    assert os.getpgrp() not in groups


def test_on_a_cpu_nobody_reads_ahead():
    assert readers_for(torch.device("cpu")) == 0
    assert 1 <= readers_for(torch.device("cuda")) <= 8
