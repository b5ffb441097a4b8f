"""Prior of scenes with a learned flow: the flow samples the objects, the fitted prior everything else."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from safetensors.torch import save
from torch import Tensor

from datagen.storage.atomic import write_atomically
from obpose.errors import CorruptFile, UsageError
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.flow import Flow
from obpose.scenes.priors.gaussian import Mixture, ScenePrior, learned_prior, load_prior
from obpose.scenes.priors.tables import Tables
from obpose.storage.tensors import Form, Forms, differences_of, forms_of, read_tensors

PriorName = Literal["flow", "fitted", "learned"]

FILE = "flow.safetensors"
"""Name of the flow's file, in the folder of the model's weights."""
_WEIGHTS = "weights"
"""Metadata key: SHA-256 of the weights that found the objects."""
_MOST_BYTES = 2**28
_AGAIN = "make it again with obpose-edit learn, or give another --prior."


@dataclass(frozen=True, eq=False)
class FlowPrior:
    """Distribution of objects, tables and backgrounds; positions are drawn between `low` and `high`."""

    flow: Flow
    tables: Tables
    background: Mixture
    low: Float[Tensor, "2"]
    """Lowest world x and y of the objects' box centres, metres."""
    high: Float[Tensor, "2"]
    """Highest world x and y of the objects' box centres, metres."""


def save_flow(origin: Origin, flow: Flow) -> Path:
    """Write a flow for `load_flow`, in half precision; give the path of the file."""
    contents = {name: tensor.half().contiguous() for name, tensor in flow.state_dict().items()}
    write_atomically(origin.folder / FILE, save(contents, metadata={_WEIGHTS: origin.hash}))
    return origin.folder / FILE


def has_flow(origin: Origin) -> bool:
    """Whether the folder of a model's weights has a learned flow."""
    return (origin.folder / FILE).is_file()


def load_flow(origin: Origin) -> FlowPrior:
    """Load the learned flow of a model, together with its fitted prior.

    Raises:
        UsageError: one of them is missing.
        CorruptFile: a file is damaged, or belongs to another model.
    """
    path = origin.folder / FILE
    if not has_flow(origin):
        raise UsageError(f"{origin.folder} has no {FILE}; make one with obpose-edit learn, or give another --prior.")
    rest = load_prior(origin)
    with torch.random.fork_rng(devices=[]):
        flow = Flow(origin.model.config.model.latent.what)
    expected = {name: Form(torch.float16, form.shape) for name, form in forms_of(flow.state_dict()).items()}

    def check(found: Forms) -> None:
        if wrong := differences_of(found, expected):
            raise ValueError(wrong)

    values, metadata = read_tensors(path, _AGAIN, check, most_bytes=_MOST_BYTES)
    if metadata.get(_WEIGHTS) != origin.hash:
        raise CorruptFile(f"{path} is of other weights than those beside it; {_AGAIN}")
    flow.load_state_dict({name: value.float() for name, value in values.items()})
    return FlowPrior(flow.eval().requires_grad_(requires_grad=False), rest.tables, rest.background, rest.low, rest.high)


def named_prior(origin: Origin, name: PriorName) -> FlowPrior | ScenePrior:
    """Load a prior by name: learned by the model, fitted to its codes, or a flow learned from objects it found.

    Raises:
        UsageError: the prior is missing.
        CorruptFile: a file is damaged, or belongs to another model.
    """
    if name == "learned":
        return learned_prior(origin.model)
    return load_flow(origin) if name == "flow" else load_prior(origin)
