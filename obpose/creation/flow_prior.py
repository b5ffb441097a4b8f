"""What scenes are sampled from where a flow was learned: it gives the objects; the table is the fitted prior's."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from obpose.creation.flow import Flow
from obpose.creation.light import Light, is_light
from obpose.creation.origin import Origin
from obpose.creation.pattern import SPOT, Pattern, pattern_like
from obpose.creation.prior import Mixture, ScenePrior, learned_prior, load_prior
from obpose.errors import CorruptFile, UsageError
from obpose.files import write_whole

PriorName = Literal["flow", "fitted", "learned"]

FILE = "flow.safetensors"
"""Beside the model's weights."""
_WEIGHTS = "weights"
"""In the file's metadata: SHA-256 of the file of the weights that found the objects."""
_LIGHTS, _SPOTS = "lights", "spots"
_AGAIN = "make it again with obpose-edit learn, or give another --prior."


@dataclass(frozen=True, eq=False)
class Tables:
    """Lights and patterns of tables that were found in clips, to be drawn from."""

    lights: Float[Tensor, "table 4"]
    """As `Scene.light`."""
    spots: Float[Tensor, "table spot spot 3"]
    """Of patterns; those that are drawn are like one of them (`obpose.creation.pattern`)."""

    def draw(self, generator: torch.Generator) -> tuple[Light, Pattern]:
        """Of one of the tables."""
        place = int(torch.randint(len(self.lights), (), generator=generator))
        return self.lights[place], pattern_like(self.spots[place], generator)


@dataclass(frozen=True, eq=False)
class FlowPrior:
    """A distribution of scenes, as far as their objects' places are not the user's."""

    flow: Flow
    tables: Tables
    background: Mixture
    low: Float[Tensor, "2"]
    """Of the objects' middles, world x and y, metres."""
    high: Float[Tensor, "2"]


def save_flow(origin: Origin, flow: Flow, tables: Tables) -> Path:
    """Write what `load_flow` reads, but for the lights in half precision; give the file."""
    contents = {name: tensor.half().contiguous() for name, tensor in flow.state_dict().items()}
    contents |= {_LIGHTS: tables.lights, _SPOTS: tables.spots.half()}
    write_whole(origin.folder / FILE, save(contents, metadata={_WEIGHTS: origin.hash}))
    return origin.folder / FILE


def has_flow(origin: Origin) -> bool:
    """Whether there is one beside a model's weights."""
    return (origin.folder / FILE).is_file()


def load_flow(origin: Origin) -> FlowPrior:
    """The flow that was learned from what a model found, with the prior that was fitted to it.

    Raises:
        UsageError: one of them is not there.
        CorruptFile: a file is damaged, or another model's.
    """
    path = origin.folder / FILE
    if not has_flow(origin):
        raise UsageError(f"{origin.folder} has no {FILE}; make one with obpose-edit learn, or give another --prior.")
    rest = load_prior(origin)
    try:
        with safe_open(path, framework="pt") as file:
            values = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118 (not a dict)
            weights = (file.metadata() or {}).get(_WEIGHTS)
        with torch.random.fork_rng(devices=[]):
            flow = Flow(origin.model.config.model.latent.what)
        lights, spots = values.pop(_LIGHTS), values.pop(_SPOTS)
        flow.load_state_dict(values)
    except (SafetensorError, KeyError, RuntimeError):
        raise CorruptFile(f"{path} is damaged, or of another version; {_AGAIN}") from None
    if weights != origin.hash:
        raise CorruptFile(f"{path} is of other weights than those beside it; {_AGAIN}")
    finite = all(bool(value.isfinite().all()) for value in values.values())
    if not finite or not _are_tables(lights, spots):
        raise CorruptFile(f"{path} is damaged; {_AGAIN}")
    return FlowPrior(
        flow.eval().requires_grad_(requires_grad=False), Tables(lights, spots), rest.background, rest.low, rest.high
    )


def _are_tables(lights: Tensor, spots: Tensor) -> bool:
    """Whether the arrays fit each other and hold numbers; files may come from anywhere."""
    count = len(spots) if spots.ndim else 0
    sizes = count > 0 and lights.shape == (count, 4) and spots.shape == (count, SPOT, SPOT, 3)
    return sizes and bool(spots.isfinite().all()) and all(map(is_light, lights))


def named_prior(origin: Origin, name: PriorName) -> FlowPrior | ScenePrior:
    """That a model learned, or that was fitted to its codes, or learned from objects that it found.

    Raises:
        UsageError: it is not there.
        CorruptFile: a file is damaged, or another model's.
    """
    if name == "learned":
        return learned_prior(origin.model)
    return load_flow(origin) if name == "flow" else load_prior(origin)
