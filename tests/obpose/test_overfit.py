"""Each system learns to tell two objects apart from each other and from the table.

Boxes, or labels, tell two objects apart in a single scene. Fields that fill the world explain both of them at once
just as well; only where they have to explain several scenes is there something to be gained by one slot for each. The
IC-SBP, which has no background either, takes longest.
"""

from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import torch

from benchmark.metrics import clip_scores
from obpose.config import TrainConfig
from obpose.systems import build_model, find_system
from obpose.trainable import Trainable
from obpose.training.budget import learning_rate
from obpose.types import LabelledObservation
from tests.worlds.observations import labels_by_colour, table_scene

SIZE, OBJECTS = 48, 2
SCENE = {
    "model.slots": OBJECTS,
    "model.spacing": 0.016,
    "model.workspace_size": 0.8,
    "model.background_size": 2.2,
}


def scenes(count: int, frames: int, *, anywhere: bool = False) -> LabelledObservation:
    """Spheres on tables; colours say what is what, and what there is most of is the table."""
    size = {"height": SIZE, "width": SIZE}
    seen = table_scene(batch=count, frames=frames, spheres=OBJECTS, anywhere=anywhere, **size)
    labels = torch.stack([labels_by_colour(rgb) for rgb in seen.rgb])
    parts = {field.name: getattr(seen, field.name) for field in fields(seen)}
    return LabelledObservation(**parts, segmentation=labels)


def overfit(model: Trainable, clips: LabelledObservation, *, steps: int, batch: int) -> None:
    optimizer, rates = torch.optim.Adam(model.parameters()), TrainConfig()
    generator = torch.Generator().manual_seed(0)
    model.train()
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(rates, step / steps)
        some = torch.randint(len(clips.depth), (batch,), generator=generator)
        window = model.observation_type(
            **{field.name: getattr(clips, field.name)[some] for field in fields(model.observation_type)}
        )
        total = model.losses(window, step=step, fraction=step / steps, generator=generator)["total"]
        optimizer.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()
    model.eval()


def scores(model: Trainable, clips: LabelledObservation) -> dict[str, float]:
    """Means over the frames, of objects' pixels and of all."""
    labels = model.segment(clips).labels
    each = [clip_scores(true.numpy(), found.numpy()) for true, found in zip(clips.segmentation, labels, strict=True)]
    return {name: float(np.mean([score[name] for score in each])) for name in ("ari_fg", "ari")}


_SEEDS = 4
"""Number of fresh models that may try. Arithmetic of another machine is another seed, and slot attention, for one,
keeps both objects in one slot with some seeds."""


@pytest.mark.learning
@pytest.mark.timeout(1200)
@pytest.mark.parametrize(
    ("system", "changes", "count", "steps", "least"),
    [
        ("supervised", {}, 1, 300, 0.99),
        ("obpose", {"train.warmup": 100}, 1, 300, 0.99),
        ("obpose-loc", {"train.warmup": 100}, 1, 300, 0.99),
        ("slot-attention", {}, 16, 900, 0.99),
        ("ic-sbp", {}, 8, 2000, 0.99),
    ],
)
def test_two_objects_are_told_apart(system: str, changes: dict[str, Any], count: int, steps: int, least: float):
    clips = scenes(count, frames=1 if count > 1 else 2)
    tries = []
    for seed in range(_SEEDS):
        torch.manual_seed(seed)
        model = fresh_model(system, changes)
        overfit(model, clips, steps=steps, batch=min(2, count))
        tries.append(scores(model, clips))
        if tries[-1]["ari_fg"] > least and tries[-1]["ari"] > 0.97:
            return
    pytest.fail(f"Of {_SEEDS} seeds none tells them apart: {tries}.")


@pytest.mark.learning
@pytest.mark.timeout(900)
def test_slot_attention_tells_objects_apart_that_stand_anywhere():
    """Objects stand anywhere, so that a fixed division of the table does not suffice."""
    clips = scenes(64, frames=1, anywhere=True)
    torch.manual_seed(0)
    model = fresh_model("slot-attention", {})
    overfit(model, clips, steps=2000, batch=4)
    assert scores(model, clips)["ari_fg"] > 0.9


def fresh_model(system: str, changes: dict[str, Any]) -> Trainable:
    found = find_system(system)
    config = found.config("cpu", found.known(SCENE) | changes)
    found.architecture.check(config)
    return build_model(config)
