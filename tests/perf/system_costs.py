"""Costs of a training step of each learned system in the profile `cpu`, after warm-ups.

python -m tests.perf.system_costs SYSTEM    one of them in a process of its own; prints JSON
"""

import json
import resource
import sys
import time
from dataclasses import asdict, dataclass, fields
from statistics import median

import torch

from obpose.contact.pasting import IMAGES_PER_FRAME
from obpose.systems import SYSTEMS, build_model
from obpose.training.devices import keep_memory, make_fabric
from obpose.training.learner import Learner
from obpose.types import ContactObservation, LabelledObservation, PastedObservation
from tests.worlds.observations import labels_by_colour, table_scene

FRAMES, SIZE, OBJECTS = 5, 64, 4
STEPS = 15


@dataclass(frozen=True)
class Cost:
    """Costs of one system."""

    parameters: int
    images: int
    """A step."""
    seconds: float
    """Median CPU time of a step."""
    megabytes: float
    """Peak of the whole process, Python and libraries included."""


def cost_of(name: str) -> Cost:
    """Steps on as many images as a step has, in clips of 5 frames of 64x64 with four spheres on a table."""
    system = SYSTEMS[name]
    measured = {
        "model.workspace_center": (0.0, 0.0, 0.1),
        "model.workspace_size": 1.0,
        "model.background_size": 1.5,
        "model.spacing": 0.012,
    }
    config = system.config("cpu", system.known(measured))
    learner = Learner(make_fabric("cpu", config.train), config, build_model)
    frames = min(FRAMES, config.train.frames)
    clips = config.train.batch * (config.train.frames // frames)
    seen = table_scene(batch=clips, frames=frames, height=SIZE, width=SIZE, spheres=OBJECTS)
    batch = {field.name: getattr(seen, field.name) for field in fields(seen)}
    labels = torch.stack([labels_by_colour(rgb) for rgb in seen.rgb])
    kind = learner.model.observation_type
    if kind is LabelledObservation:
        batch["segmentation"] = labels
    if issubclass(kind, PastedObservation):
        batch["pseudo_labels"] = labels
    if kind is ContactObservation:
        # The frames themselves stand in for pasted images.
        chosen = torch.arange(round(IMAGES_PER_FRAME * frames)) % frames
        images = {"rgb": seen.rgb, "depth": seen.depth, "labels": labels}
        batch |= {f"pasted_{name}": each[:, chosen, 0] for name, each in images.items()}
        for camera in ("k", "world_from_camera"):
            batch[f"pasted_{camera}"] = batch[camera][:, :1].expand(-1, len(chosen), -1, -1)
    times = []
    for step in range(STEPS + 1):
        start = time.process_time()
        learner.step(batch, step=config.train.warmup + step, fraction=0.5, learning_rate=1e-4)
        times.append(time.process_time() - start)
    return Cost(
        parameters=sum(parameter.numel() for parameter in learner.model.parameters()),
        images=clips * frames,
        seconds=median(times[1:]),
        megabytes=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000,
    )


if __name__ == "__main__":
    torch.set_num_threads(1)
    keep_memory()
    print(json.dumps(asdict(cost_of(sys.argv[1]))))
