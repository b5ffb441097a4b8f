"""Priors of scenes: those that the model learned, or mixtures of Gaussians fitted to the latents it infers.

The learned priors have little weight in training (`loss.kl`), and latents of real scenes fill only a few of their
directions. Mixtures fitted afterwards to the posterior means of training clips (ex-post density estimation, Ghosh et
al. 2020) match them better. A single Gaussian has most of its mass between the kinds of objects. Neither prior uses
labels.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from safetensors.torch import save
from torch import Tensor

from datagen.console.text import counted
from datagen.storage.atomic import write_atomically
from obpose.errors import CorruptFile, UsageError
from obpose.model.obpose import ObPose
from obpose.scenes.appearance.table_texture import SPOT
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.tables import Tables, are_tables, no_tables
from obpose.storage.tensors import Form, Forms, differences_of, read_tensors
from obpose.types import Observation

if TYPE_CHECKING:  # it takes a second to import, which only fitting needs
    from sklearn.mixture import GaussianMixture

FILE = "prior.safetensors"
"""Name of the prior's file, in the folder of the model's weights."""
_WEIGHTS = "weights"
"""Metadata key: SHA-256 of the weights that the prior was fitted to."""
_AGAIN = "make it again with obpose-edit fit, or give --prior learned."
_PARTS = "weights", "means", "factors"
_MIXTURES = "what", "background"
_TABLES = {"lights", "spots"}
_MOST_BYTES = 2**28
_LARGEST_VALUE = 1e6
_ROUNDING = 1e-3
"""Largest difference of the sum of mixture weights from 1."""
_HELD = 5
"""Interval of held-out values: every 5th is held out to choose the number of Gaussians."""
_LEAST_VALUES = 16
"""Least number of values for each Gaussian."""
_MOST_POWER = 6
"""Exponent of 2 that gives the largest number of Gaussians."""
_LEAST_VARIANCE = 1e-3
"""Variance added to each Gaussian along all axes, as a share of the mean variance of the values."""
_MARGIN = 0.02
"""Share of the objects that are ignored at each end when the occupied part of the table is estimated."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """A mixture of normal distributions."""

    weights: Float[Tensor, "part"]
    """Mixture weights, which sum to one."""
    means: Float[Tensor, "part latent"]
    factors: Float[Tensor, "part latent latent"]
    """Factors of the covariances: that of a part is factor factor^T."""

    def draw(self, count: int, generator: torch.Generator) -> Float[Tensor, "count latent"]:
        """Draw independent samples."""
        if count == 0:
            return self.means[:0]
        part = self.weights.multinomial(count, replacement=True, generator=generator)
        noise = torch.randn(count, self.means.shape[1], generator=generator)
        return self.means[part] + torch.einsum("nij,nj->ni", self.factors[part], noise)


@dataclass(frozen=True, eq=False)
class ScenePrior:
    """Distribution of the latents of a first frame and of tables; positions are drawn between `low` and `high`."""

    what: Mixture
    background: Mixture
    tables: Tables
    low: Float[Tensor, "2"]
    """Lowest world x and y of the objects' box centres, metres."""
    high: Float[Tensor, "2"]
    """Highest world x and y of the objects' box centres, metres."""


def learned_prior(model: ObPose) -> ScenePrior:
    """Give the prior that the model learned (paper, section Object Location and Orientation Conditioned Encoding).

    It does not cover positions and tables: objects are put in the middle half of the workspace, tables have no light
    and no pattern.
    """
    assert model.background is not None
    half = model.config.model.workspace_size / 4
    middle = model.center[:2]
    what, background = (
        Mixture(torch.ones(1), mean[None], torch.diag(std)[None])
        for mean, std in (model.what.first(), model.background.first())
    )
    return ScenePrior(what, background, no_tables(middle), middle - half, middle + half)


@torch.no_grad()
def fit_prior(model: ObPose, clips: Iterable[Observation], tables: Tables) -> ScenePrior:
    """Fit mixtures to the posterior means of the first frames of clips (each a batch of one); `tables` stay as given.

    Raises:
        UsageError: too few objects were found for a covariance.
    """
    what, background, center = [], [], []
    for clip in clips:
        inference = model.segment(clip).inference
        assert inference.background is not None
        active = inference.masks.active[0]
        what.append(inference.what.mean[0, 0, active])
        center.append(inference.boxes.center[0, 0, active, :2])
        background.append(inference.background.mean[0, 0])
    objects, scenes = (torch.cat(what) if what else torch.zeros(0, 1)), len(background)
    if len(objects) < 2 or scenes < 2:
        raise UsageError(
            f"Objects found: {len(objects)} in {counted(scenes, 'clip')}; expected at least 2 in 2 clips. Give more "
            "--clips."
        )
    mixtures = fit_mixture(objects), fit_mixture(torch.stack(background))
    return ScenePrior(*mixtures, tables, *table_part(torch.cat(center)))


def table_part(places: Float[Tensor, "n 2"]) -> tuple[Float[Tensor, "2"], Float[Tensor, "2"]]:
    """Estimate the part of the table where nearly all objects are; give its lowest and its highest x and y."""
    low, high = (torch.quantile(places, share, dim=0) for share in (_MARGIN, 1 - _MARGIN))
    return low, high


def save_prior(origin: Origin, prior: ScenePrior) -> None:
    """Write a prior for `load_prior` beside the weights it belongs to, with their hash."""
    tensors = {"low": prior.low, "high": prior.high}
    tensors |= {"lights": prior.tables.lights, "spots": prior.tables.spots.half()}
    for name, mixture in (("what", prior.what), ("background", prior.background)):
        tensors |= {f"{name}.{part}": getattr(mixture, part) for part in _PARTS}
    contents = {name: tensor.contiguous() for name, tensor in tensors.items()}
    write_atomically(origin.folder / FILE, save(contents, metadata={_WEIGHTS: origin.hash}))


def has_prior(origin: Origin) -> bool:
    """Whether the folder of a model's weights has a fitted prior."""
    return (origin.folder / FILE).is_file()


def load_prior(origin: Origin) -> ScenePrior:
    """Load the fitted prior of a model.

    Raises:
        UsageError: there is none.
        CorruptFile: the file is damaged, or belongs to another model.
    """
    path = origin.folder / FILE
    if not has_prior(origin):
        raise UsageError(f"{origin.folder} has no {FILE}; make one with obpose-edit fit first.")
    found, metadata = read_tensors(path, _AGAIN, partial(_check_file, origin.model), most_bytes=_MOST_BYTES)
    weights = metadata.get(_WEIGHTS)
    if weights is None:
        raise CorruptFile(f"{path} does not say which weights it was fitted to, as older ones; {_AGAIN}")
    if weights != origin.hash:
        raise CorruptFile(f"{path} was fitted to other weights than those beside it; {_AGAIN}")
    what, background = (Mixture(*(found[f"{name}.{part}"] for part in _PARTS)) for name in _MIXTURES)
    # Priors of older versions have no tables.
    none = no_tables(found["low"])
    tables = Tables(found.get("lights", none.lights), found.get("spots", none.spots).float())
    prior = ScenePrior(what, background, tables, found["low"], found["high"])
    if wrong := _fault(prior):
        raise CorruptFile(f"{path} is damaged ({wrong}); {_AGAIN}")
    return prior


def _check_file(model: ObPose, found: Forms) -> None:
    """Check names, types and shapes: two mixtures, a part of the table, and optionally tables."""
    latent = model.config.model.latent
    expected = {"low": Form(torch.float32, (2,)), "high": Form(torch.float32, (2,))}
    for name, size in zip(_MIXTURES, (latent.what, latent.background), strict=True):
        parts = _length(found, f"{name}.weights")
        shapes = (parts,), (parts, size), (parts, size, size)
        expected |= {f"{name}.{part}": Form(torch.float32, shape) for part, shape in zip(_PARTS, shapes, strict=True)}
    if _TABLES & found.keys():
        tables = _length(found, "lights")
        expected["lights"] = Form(torch.float32, (tables, 4))
        expected["spots"] = Form(torch.float16, (tables, SPOT, SPOT, 3))
    if wrong := differences_of(found, expected):
        raise ValueError(wrong)


def _length(found: Forms, name: str) -> int:
    """Length of a tensor's first axis; 1 if there is none."""
    return found[name].shape[0] if name in found and found[name].shape else 1


def _fault(prior: ScenePrior) -> str | None:
    """Describe the first invalid value of a prior; None if all are valid."""
    for mixture in (prior.what, prior.background):
        if not 1 <= len(mixture.weights) <= 2**_MOST_POWER:
            return f"a mixture has {len(mixture.weights)} parts, expected 1 to {2**_MOST_POWER}"
        if not bool((mixture.weights >= 0).all()) or abs(float(mixture.weights.sum()) - 1) > _ROUNDING:
            return "the weights of a mixture do not sum to one"
        if max(float(part.abs().max()) for part in (mixture.means, mixture.factors)) > _LARGEST_VALUE:
            return f"a mixture has values above {_LARGEST_VALUE:g}"
    if not bool((prior.low <= prior.high).all()):
        return "low is above high"
    return None if are_tables(prior.tables.lights, prior.tables.spots) else "lights are neither unit vectors nor none"


def fit_mixture(values: Float[Tensor, "n latent"]) -> Mixture:
    """Fit 1, 2, 4 ... Gaussians; the number doubles while the likelihood of held-out values increases.

    A few values give a single Gaussian with their mean and covariance. The result depends only on the values and their
    order.
    """
    held = torch.arange(len(values)) % _HELD == 0
    count, best = 1, -torch.inf
    for power in range(_MOST_POWER + 1):
        if 2**power * _LEAST_VALUES > (~held).sum():
            break
        score = _expectation_maximisation(values[~held], 2**power).score(values[held].numpy())
        if score <= best:
            break
        count, best = 2**power, score
    if count == 1:
        return _gaussian(values)
    found = _expectation_maximisation(values, count)
    parts = found.weights_, found.means_, np.linalg.cholesky(np.asarray(found.covariances_))
    return Mixture(*(torch.from_numpy(part).float() for part in parts))


def _expectation_maximisation(values: Float[Tensor, "n latent"], count: int) -> "GaussianMixture":
    from sklearn.mixture import GaussianMixture

    least = _LEAST_VARIANCE * float(values.var(dim=0).mean())
    return GaussianMixture(count, reg_covar=least, max_iter=200, random_state=0).fit(values.double().numpy())


def _gaussian(values: Float[Tensor, "n latent"]) -> Mixture:
    """Fit one Gaussian by principal axes, because there may be fewer values than dimensions."""
    mean = values.mean(dim=0)
    _, spread, axes = torch.linalg.svd(values - mean, full_matrices=False)
    factor = torch.zeros(values.shape[1], values.shape[1])
    factor[:, : len(spread)] = axes.T * (spread / (len(values) - 1) ** 0.5)
    return Mixture(torch.ones(1), mean[None], factor[None])
