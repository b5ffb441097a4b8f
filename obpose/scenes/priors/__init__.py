"""Priors that new scenes are sampled from, by name."""

from typing import Literal

from obpose.scenes.model_ref import Origin
from obpose.scenes.priors import flow_prior, gaussian
from obpose.scenes.priors.gaussian import learned_prior
from obpose.scenes.priors.interface import PriorKind, ScenePrior
from obpose.scenes.priors.train_flow import fit_flow

PriorName = Literal["flow", "gaussian", "learned"]

PRIORS: dict[PriorName, PriorKind] = {
    "flow": PriorKind(flow_prior.load_flow, flow_prior.FILE, fit_flow, clips=400),
    "gaussian": PriorKind(gaussian.load_gaussian, gaussian.FILE, gaussian.fit_gaussian, clips=500),
    "learned": PriorKind(learned_prior),
}
"""Kinds of priors, the best first."""


def available_priors(origin: Origin) -> list[PriorName]:
    """List the priors that a model has, the best first."""
    return [name for name, kind in PRIORS.items() if kind.file is None or (origin.folder / kind.file).is_file()]


def load_prior(origin: Origin, name: PriorName | None = None) -> ScenePrior:
    """Load a prior of a model by name, by default the best that it has.

    Raises:
        UsageError: the prior is missing.
        CorruptFile: a file is damaged, or belongs to another model.
    """
    return PRIORS[name or available_priors(origin)[0]].load(origin)
