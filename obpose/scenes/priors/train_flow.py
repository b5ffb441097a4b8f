"""Training of a flow on the objects that a model finds in clips; an interrupted run resumes."""

import json
import math
import shutil
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from safetensors.torch import save
from torch import Tensor, nn

from datagen.console.text import counted
from datagen.storage.atomic import locked_folder, write_atomically
from datagen.storage.safe_io import brief_reason, read_json
from obpose.data.datasets import SceneDataset
from obpose.errors import CorruptFile, Diverged, UsageError
from obpose.model.layers.latent import LATENT
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.examples import Examples, find_examples, joined
from obpose.scenes.priors.flow import Flow, describe, flow_loss, mirrored, sample_grids
from obpose.scenes.priors.flow_prior import save_flow
from obpose.scenes.priors.gaussian import load_gaussian
from obpose.scenes.priors.interface import FitSettings, Say
from obpose.storage.optimizer_state import optimizer_state, put_optimizer_state
from obpose.storage.tensors import State, differences_of, forms_of, read_tensors

PARTIAL = "flow.partial"
"""Folder of the unfinished flow, beside the weights."""
HELD = 20
"""Interval of held-out clips: the objects of every 20th clip only measure the held-out loss."""
RATE, WARM_STEPS, CLIP = 1e-3, 200, 1.0
"""Learning rate, its warm-up steps, and gradient norm limit. The rate falls in the second half."""
MEMORY = 0.999
"""Decay of the moving average of the weights, which is the result."""
_LOOKING, _LEARNING, _STATE = "looking.json", "learning.json", "state.safetensors"
"""Files of the unfinished flow: settings of the search for objects, of the training, and the training state."""
_MOST_SETTINGS_BYTES = 2**16


def fit_flow(origin: Origin, data: Path, settings: FitSettings, say: Say) -> Path:
    """Train a flow and write it beside the model's weights; give the path of the file.

    All settings but the number of workers have to stay when a training is resumed.

    Raises:
        UsageError: there is no fitted prior, too few objects are found, or the folder holds a run with other settings.
        Diverged: the loss is not finite.
        CorruptFile: a file of the interrupted run is damaged.
        Busy: another process uses the folder.
    """
    # Fail early without the fitted prior, which samples need beside the flow.
    load_gaussian(origin)
    training = {"clips": settings.clips, "steps": settings.steps, "seed": settings.seed}
    folder = origin.folder / PARTIAL
    with locked_folder(folder):
        dataset = SceneDataset(data, "train").settings_hash
        _check_same(folder / _LOOKING, {"weights": origin.hash, "data": dataset})
        if (folder / _STATE).exists():
            _check_same(folder / _LEARNING, training)
        found = find_examples(origin, data, folder, settings, say)
        write_atomically(folder / _LEARNING, json.dumps(training, indent=1).encode())
        # Train from the seed, whatever was drawn before.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            flow = Flow(LATENT)
        path = save_flow(origin, _train(flow, found, folder, settings, say))
    shutil.rmtree(folder)
    return path


def _check_same(path: Path, settings: dict[str, Any]) -> None:
    """Check that an interrupted run had these settings; write them if there is none."""
    folder = path.parent
    if not path.exists():
        write_atomically(path, json.dumps(settings, indent=1).encode())
        return
    try:
        before = read_json(path, most_bytes=_MOST_SETTINGS_BYTES)
    except CorruptFile:
        before = None
    if not isinstance(before, dict) or before.keys() != settings.keys():
        raise CorruptFile(f"{path} is damaged; delete {folder} to begin anew.")
    pairs = {name: (before[name], value) for name, value in settings.items()}
    if different := [f"{name} {there} and {here}" for name, (there, here) in pairs.items() if there != here]:
        raise UsageError(
            f"{folder} holds what was begun with other settings; there and here differ: {', '.join(different)}. Give "
            "the same ones, or delete it."
        )


def _train(flow: Flow, found: list[Examples], folder: Path, settings: FitSettings, say: Say) -> Flow:
    """Train a flow; give the moving average of its weights."""
    held, learned = joined(found[::HELD]), joined([each for place, each in enumerate(found) if place % HELD])
    if len(learned.half) < settings.least_objects:
        raise UsageError(
            f"Examples of objects found: {len(learned.half)}, and {len(held.half)} that are held out, in "
            f"{counted(len(found), 'clip')}; expected {settings.least_objects}. Give more --clips."
        )
    say(
        f"Learning from {counted(len(learned.half), 'example')} of objects, in some frames each; held out: "
        f"{len(held.half)}."
    )
    # Standardise the examples; those to learn from also mirrored.
    describe(flow, learned, torch.cat([each.what for each in found]))
    objects, others = torch.cat([flow.encode(learned), flow.encode(mirrored(learned))]), flow.encode(held)
    mean = _copy(flow).eval()
    optimiser = torch.optim.AdamW(flow.parameters(), lr=RATE, betas=(0.9, 0.99), weight_decay=0.01)
    done = _restore(folder / _STATE, flow, mean, optimiser, steps=settings.steps)
    losses: list[float] = []
    # Noise depends on seed and step alone, so that a resumed training is the same.
    for step in range(done, settings.steps):
        noise = torch.Generator().manual_seed((settings.seed << 32) + step)
        batch = objects[torch.randint(len(objects), (settings.batch,), generator=noise)]
        for group in optimiser.param_groups:
            group["lr"] = RATE * _pace(step, settings.steps)
        with torch.random.fork_rng(devices=[]):
            # Dropout draws from the global generator.
            torch.manual_seed(noise.initial_seed())
            loss = flow_loss(flow, batch, noise)
        if not loss.isfinite():
            raise Diverged(f"The loss of step {step + 1} is {loss.item()}; delete {folder}, and give another --seed.")
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(flow.parameters(), CLIP)
        optimiser.step()
        _follow(mean, flow, step)
        losses.append(loss.item())
        if (step + 1) % settings.save_steps == 0:
            _save(folder / _STATE, flow, mean, optimiser, step + 1)
            say(f"step {step + 1} of {settings.steps}: loss {sum(losses) / len(losses):.4f}{_held_out(mean, others)}")
            losses.clear()
    say(_likeness(mean, objects, others, settings.compared))
    return mean


@torch.no_grad()
def _held_out(flow: Flow, objects: Float[Tensor, "object value"]) -> str:
    if not len(objects):
        return ""
    # Each at several times, as there are few.
    return f", held out {float(flow_loss(flow, objects.repeat(8, 1), torch.Generator().manual_seed(0))):.4f}"


@torch.no_grad()
def _likeness(
    flow: Flow, learned: Float[Tensor, "one value"], held: Float[Tensor, "other value"], compared: int
) -> str:
    """Report distances of samples and of held-out objects to the training objects; copies would have smaller ones."""
    generator = torch.Generator().manual_seed(0)
    others = {
        "samples": flow.encode(sample_grids(flow, compared, generator)),
        "held-out objects": held[torch.randperm(len(held), generator=generator)[:compared]],
    }
    words = [f"{name} {nearest(values, learned):.3f}" for name, values in others.items() if len(values)]
    return f"Distance to the nearest learned object, median: {', '.join(words)}"


def nearest(objects: Float[Tensor, "object value"], among: Float[Tensor, "other value"]) -> float:
    """Median distance from each object to its nearest neighbour in another set.

    The distance is the root mean square difference of encoded values.
    """
    return float(torch.cdist(objects, among).amin(dim=1).median()) / objects.shape[1] ** 0.5


def _pace(step: int, steps: int) -> float:
    """Factor on the learning rate: linear warm-up, then cosine decay in the second half."""
    done = step / steps
    fall = 1.0 if done < 0.5 else 0.5 * (1 + math.cos(math.pi * (2 * done - 1)))
    return min(1.0, (step + 1) / WARM_STEPS) * max(fall, 0.01)


def _copy(flow: Flow) -> Flow:
    with torch.random.fork_rng(devices=[]):
        copy = Flow(len(flow.code))
    copy.load_state_dict(flow.state_dict())
    return copy.requires_grad_(requires_grad=False)


@torch.no_grad()
def _follow(mean: Flow, flow: Flow, step: int) -> None:
    share = 1 - min(MEMORY, (step + 1) / (step + 10))
    for old, new in zip(mean.parameters(), flow.parameters(), strict=True):
        old.lerp_(new, share)


def _save(path: Path, flow: Flow, mean: Flow, optimiser: torch.optim.Optimizer, step: int) -> None:
    parts = {"flow": flow.state_dict(), "mean": mean.state_dict(), "optimiser": optimizer_state(flow, optimiser)}
    tensors = {f"{part}.{name}": value for part, values in parts.items() for name, value in values.items()}
    contents = {name: value.detach().contiguous() for name, value in tensors.items()}
    write_atomically(path, save(contents, metadata={"step": str(step)}))


def _restore(path: Path, flow: Flow, mean: Flow, optimiser: torch.optim.Optimizer, *, steps: int) -> int:
    """Restore an interrupted training; give the number of steps done."""
    if not path.exists():
        return 0
    advice = "delete it, and run the same command again."
    tensors, metadata = read_tensors(path, advice)
    parts: dict[str, State] = {"flow": {}, "mean": {}, "optimiser": {}}
    try:
        for name, tensor in tensors.items():
            part, _, rest = name.partition(".")
            parts[part][rest] = tensor
        for model, part in ((flow, "flow"), (mean, "mean")):
            if wrong := differences_of(forms_of(parts[part]), forms_of(model.state_dict())):
                raise ValueError(wrong)
            model.load_state_dict(parts[part])
        put_optimizer_state(flow, optimiser, parts["optimiser"])
        step = int(metadata["step"])
        if not 0 < step <= steps or not parts["optimiser"]:
            raise ValueError(f"it is of step {step} of {steps}")
    except (KeyError, ValueError) as error:
        raise CorruptFile(f"{path} is damaged ({brief_reason(error)}); {advice}") from None
    return step
