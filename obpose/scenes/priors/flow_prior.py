"""Prior with a learned flow: the flow samples the objects, the fitted mixtures everything else."""

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from safetensors.torch import save

from datagen.storage.atomic import write_atomically
from obpose.errors import UsageError
from obpose.model.layers.latent import LATENT
from obpose.model.nerf.voxels import THRESHOLD, occupancy
from obpose.model.obpose import ObPose
from obpose.scenes.appearance import Appearance
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.codes import draw_dense
from obpose.scenes.priors.flow import Flow, sample_grids
from obpose.scenes.priors.gaussian import load_gaussian
from obpose.scenes.priors.grids import Grids, together
from obpose.scenes.priors.interface import WEIGHTS, Objects, ScenePrior, read_prior
from obpose.storage.tensors import forms_of, pack

FILE = "flow.safetensors"
"""Name of the flow's file, in the folder of the model's weights."""
_AGAIN = "make it again with obpose-edit fit-prior --kind flow, or give another --prior."


@dataclass(frozen=True, eq=False)
class FlowObjects:
    """Distribution of whole objects with their details, as grids that replace the object field."""

    flow: Flow

    @torch.no_grad()
    def draw(self, model: ObPose, count: int, generator: torch.Generator) -> Objects:
        """Draw objects that have enough voxels; after too many attempts, any objects."""

        def voxels(grid: Grids) -> int:
            return int((occupancy(grid.values[..., 0]) > THRESHOLD).sum())

        drawn = draw_dense(lambda missing: sample_grids(self.flow, missing, generator).apart(), voxels, count)
        grids = together(drawn, like=self.flow.code)
        # Boxes share the centres and axes of the grids; parts of a grid outside of its box are cut off.
        scale = 2 * grids.half / model.config.model.pose.box_size
        appearance = Appearance(grids.values, own_scale=scale, half_extent=scale.new_zeros(len(scale), 3))
        return Objects(self.flow.code.expand(count, -1), appearance, face_camera=True)


def save_flow(origin: Origin, flow: Flow) -> Path:
    """Write a flow for `load_flow`, with matrices as int8; give the path of the file."""
    write_atomically(origin.folder / FILE, save(pack(flow.state_dict(), "int8"), metadata={WEIGHTS: origin.hash}))
    return origin.folder / FILE


def load_flow(origin: Origin) -> ScenePrior:
    """Load the learned flow of a model, together with its fitted mixtures.

    Raises:
        UsageError: one of them is missing.
        CorruptFile: a file is damaged, or belongs to another model.
    """
    if not (origin.folder / FILE).is_file():
        raise UsageError(
            f"{origin.folder} has no {FILE}; make one with obpose-edit fit-prior --kind flow, or give another --prior."
        )
    rest = load_gaussian(origin)
    with torch.random.fork_rng(devices=[]):
        flow = Flow(LATENT)
    expected = forms_of(flow.state_dict())
    flow.load_state_dict(read_prior(origin, FILE, _AGAIN, lambda _: expected))
    return replace(rest, objects=FlowObjects(flow.eval().requires_grad_(requires_grad=False)))
