"""A model and clips that are as small as can be, and a training of them in a process of its own."""

import dataclasses
import os
import sys
from pathlib import Path

import torch
from torch import Tensor, nn

from obpose.config import Config
from obpose.trainable import Trainable
from obpose.types import Boxes, Embeddings, Inference, Latent, Masks, Observation, SceneSegmentation
from obpose.variants import make_config

SIZE = 8
SLOTS = 2


class ToyModel(Trainable):
    """Guesses the colour of a pixel from its depth; in the warm-up it learns a mean colour only."""

    noise = 0.1

    def __init__(self, config: Config):
        super().__init__()
        self.config = config
        self.mean = nn.Parameter(torch.zeros(3))
        self.layers = nn.Sequential(nn.Linear(1, 8), nn.Tanh(), nn.Linear(8, 3))

    def losses(
        self, observation: Observation, *, step: int, fraction: float, generator: torch.Generator | None
    ) -> dict[str, Tensor]:
        depth = observation.depth[..., None]
        noise = self.noise * torch.rand(depth.shape, generator=generator, device=depth.device)
        spread = (self.mean**2).sum()
        if step < self.config.train.warmup:
            error = (observation.rgb - self.mean + noise) ** 2
            return {"total": error.mean() + spread, "colour": error.mean().detach()}
        error = (observation.rgb - self.mean - self.layers(depth + noise)) ** 2
        return {"total": error.mean() + spread, "colour": error.mean().detach(), "spread": spread.detach()}

    def segment(self, observation: Observation) -> SceneSegmentation:
        """Give red pixels to slot 1, and empty attention masks."""
        labels = (observation.rgb[..., 0] > 0.5).long()
        return SceneSegmentation(labels, torch.zeros_like(labels), _inference(observation))


class QuietToy(ToyModel):
    """Toy model without noise."""

    noise = 0.0


class ToyClips:
    """Noise with one red object of constant place, and its labels if asked for."""

    def __init__(self, clips: int = 5, frames: int = 4, views: int = 1, *, labels: bool = False):
        self._clips, self.frames_of_clip, self._views, self._labels = clips, frames, views, labels

    def __len__(self) -> int:
        return self._clips

    def window(self, index: int, start: int, frames: int) -> dict[str, Tensor]:
        generator = torch.Generator().manual_seed(index)
        shape = (self.frames_of_clip, self._views, SIZE, SIZE)
        rgb = 0.4 * torch.rand((*shape, 3), generator=generator)
        depth = 0.5 + torch.rand(shape, generator=generator)
        labels = torch.zeros(shape, dtype=torch.int64)
        labels[..., 2:5, 2:5], labels[..., 6:, 6:] = 1, 2
        rgb[..., 0] += 0.6 * (labels > 0)
        cut = slice(start, start + frames)
        camera = torch.tensor([[SIZE, 0, SIZE / 2], [0, SIZE, SIZE / 2], [0, 0, 1.0]])
        found = {
            "rgb": rgb[cut],
            "depth": depth[cut],
            "valid": torch.ones(shape, dtype=torch.bool)[cut],
            "k": camera.expand(self._views, 3, 3),
            "world_from_camera": torch.eye(4).expand(self._views, 4, 4),
        }
        return found | ({"segmentation": labels[cut]} if self._labels else {})


def toy_config(**changes: object) -> Config:
    """Six steps of two windows of two frames, the first two warm-up."""
    return make_config(**{"train.steps": 6, "train.frames": 2, "train.warmup": 2, **changes})


def _inference(observation: Observation) -> Inference:
    batch, frames = observation.depth.shape[:2]
    points = torch.zeros(batch, frames, 1, 3)
    valid = torch.ones(batch, frames, 1, dtype=torch.bool)
    latents = {field.name: torch.zeros(batch, frames, SLOTS, 1) for field in dataclasses.fields(Latent)}
    background = {name: value[:, :, 0] for name, value in latents.items()}
    center = torch.tensor([0.0, 0.0, 1.0]).expand(batch, frames, SLOTS, 3)
    return Inference(
        embeddings=Embeddings(points, valid, points, points, points, points, points[:, :, 0], None),
        masks=Masks(
            torch.zeros(batch, frames, 1 + SLOTS, 1),
            torch.zeros(batch, frames, 1),
            torch.ones(batch, SLOTS, dtype=torch.bool),
        ),
        observed_center=center,
        boxes=Boxes(center, torch.eye(3).expand(batch, frames, SLOTS, 3, 3), 0.5),
        where=Latent(**latents),
        what=Latent(**latents),
        background=Latent(**background),
    )


def main() -> None:
    """`python -m tests.obpose.toy FOLDER STEPS BATCH SECONDS`: train, each step taking so long, without noise."""
    import time

    from obpose.training.loop import train

    folder, steps, batch, seconds = sys.argv[1:]

    class SlowToy(QuietToy):
        def losses(self, observation: Observation, **options: object) -> dict[str, Tensor]:
            time.sleep(float(seconds))
            slow_down_other_threads()
            return super().losses(observation, **options)

    config = toy_config(**{"train.steps": int(steps), "train.batch": int(batch)})
    train(ToyClips(), ToyClips(labels=True), config, folder=Path(folder), device="cpu", build=SlowToy)


def slow_down_other_threads() -> None:
    """Let threads other than the main one run only while it waits, which brings out deadlocks at the end.

    They share a core with it, at the lowest priority.
    """
    cores = sorted(os.sched_getaffinity(0))
    core = cores[int(os.environ.get("LOCAL_RANK", 0)) % len(cores)]
    for thread in map(int, os.listdir("/proc/self/task")):
        os.sched_setaffinity(thread, {core})
        if thread != os.getpid():
            os.sched_setscheduler(thread, os.SCHED_IDLE, os.sched_param(0))


if __name__ == "__main__":
    from obpose.errors import DatagenError

    try:
        main()
    except DatagenError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
