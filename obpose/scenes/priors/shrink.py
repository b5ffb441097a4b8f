"""Storage of a checkpoint in fewer bytes, for the weights that ship with the package."""

from pathlib import Path

from safetensors.torch import save

from datagen.storage.atomic import write_atomically
from obpose.scenes.model_ref import load_origin
from obpose.scenes.priors import available_priors
from obpose.scenes.priors.flow_prior import FlowObjects, load_flow, save_flow
from obpose.scenes.priors.gaussian import load_gaussian, save_gaussian
from obpose.storage.checkpoint import MODEL, signed_model
from obpose.storage.tensors import Precision, pack, read_tensors


def shrink_checkpoint(folder: Path, precision: Precision = "float16") -> None:
    """Store the weights of a folder in a precision, and its priors anew beside them.

    Priors hold the hash of the weights that they belong to. Scenes of the former weights become unreadable.

    Raises:
        UsageError: there is no model, or it is not a variant of ObPose with poses.
        CorruptFile: a file is damaged, or a prior belongs to other weights.
    """
    origin = load_origin(str(folder))
    names = available_priors(origin)
    gaussian = load_gaussian(origin) if "gaussian" in names else None
    flow = load_flow(origin).objects if "flow" in names else None
    tensors, metadata = read_tensors(folder / MODEL, "train it again.")
    with signed_model(folder):
        write_atomically(folder / MODEL, save(pack(tensors, precision), metadata=metadata))
    changed = load_origin(str(folder))
    if gaussian is not None:
        save_gaussian(changed, gaussian)
    if isinstance(flow, FlowObjects):
        save_flow(changed, flow.flow)
