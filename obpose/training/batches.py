"""Windows of clips for each training step, which depend only on the seed and the step."""

import atexit
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import count

import numpy as np
import torch
from jaxtyping import Int
from joblib import cpu_count
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from obpose.data.clips import ClipSource, stack
from obpose.errors import DatagenError
from obpose.random_streams import training_rng
from obpose.types import Observation

READERS_FOR_A_GPU = 8
"""Largest number of reader processes with a GPU; on a CPU reading takes about 1 % of a step and needs none."""


@dataclass(frozen=True)
class Window:
    """Consecutive frames of a clip."""

    clip: int
    start: int
    frames: int


@dataclass(frozen=True)
class Sampling:
    """Choice of the windows of each step."""

    clips: int
    """Number of clips in the source."""
    frames_of_clip: int
    frames: int
    """Frames of a window."""
    batch: int
    """Windows per step, over all processes."""
    seed: int

    def windows(self, step: int) -> list[Window]:
        """Choose the windows of a step: each clip once per shuffled epoch, at a random first frame."""
        places = training_rng(self.seed, "window", step).integers(
            self.frames_of_clip - self.frames + 1, size=self.batch
        )
        numbers = range(step * self.batch, (step + 1) * self.batch)
        return [
            Window(self._clip(number), int(place), self.frames) for number, place in zip(numbers, places, strict=True)
        ]

    def _clip(self, number: int) -> int:
        epoch, place = divmod(number, self.clips)
        return int(_order(self.seed, epoch, self.clips)[place])


@dataclass(frozen=True)
class Share:
    """Part of a batch that belongs to one of several processes."""

    process: int = 0
    processes: int = 1

    def of(self, windows: Sequence[Window]) -> Sequence[Window]:
        """Select the windows of this process."""
        each = len(windows) // self.processes
        return windows[self.process * each : (self.process + 1) * each]


def batches(
    source: ClipSource,
    sampling: Sampling,
    share: Share,
    *,
    first_step: int,
    readers: int,
    kind: type[Observation] = Observation,
) -> Iterator[dict[str, Tensor]]:
    """Iterate endlessly over the batches of this process from a step on; `readers` processes read ahead, 0 for none.

    Batches hold only the fields of `kind`, the observation type of the model.

    Raises:
        DatagenError, OSError: a clip cannot be read; errors in reader processes are raised unchanged.
    """
    loader = DataLoader(
        _Steps(source, sampling, share, kind),
        batch_size=None,
        sampler=count(first_step),  # pyright: ignore[reportArgumentType]
        num_workers=readers,
        worker_init_fn=_begin_and_end_apart if readers else None,
        multiprocessing_context="spawn" if readers else None,
        pin_memory=readers > 0 and torch.cuda.is_available(),
        # Without a generator of its own the loader would draw from the global one.
        generator=torch.Generator(),
    )
    return _raised(iter(loader))


def readers_for(device: torch.device) -> int:
    """Number of processes that should read ahead."""
    return 0 if device.type == "cpu" else min(READERS_FOR_A_GPU, max(1, cpu_count() - 1))


def _raised(items: Iterator[dict[str, Tensor] | Exception]) -> Iterator[dict[str, Tensor]]:
    """Yield batches, and raise an error that takes the place of one."""
    for item in items:
        if isinstance(item, Exception):
            # The error's traceback would keep the readers alive.
            del items
            raise item
        yield item


class _Steps(Dataset[dict[str, Tensor] | Exception]):
    """Dataset whose item `step` is the batch of that step, or the error raised while reading it.

    Errors are returned, because raising in a reader process would add its traceback to the message.
    """

    def __init__(self, source: ClipSource, sampling: Sampling, share: Share, kind: type[Observation]):
        self._source, self._sampling, self._share, self._kind = source, sampling, share, kind

    def __getitem__(self, step: int) -> dict[str, Tensor] | Exception:
        windows = self._share.of(self._sampling.windows(step))
        try:
            clips = [self._source.window(window.clip, window.start, window.frames) for window in windows]
            return stack(clips, self._kind)
        except (DatagenError, OSError) as error:
            return error.with_traceback(None)


def _begin_and_end_apart(_reader: int) -> None:
    # Signals to the parent's process group, such as Ctrl-C, no longer end readers.
    os.setsid()
    # A normal exit of the interpreter would unwind the thread that still sends a batch, and abort.
    atexit.register(os._exit, 0)


@lru_cache(maxsize=2)
def _order(seed: int, epoch: int, clips: int) -> Int[np.ndarray, " clips"]:
    return training_rng(seed, "epoch", epoch).permutation(clips)
