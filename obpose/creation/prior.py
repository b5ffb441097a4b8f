"""What scenes are sampled from: the priors that the model learned, or Gaussians fitted to what it infers.

The learned priors hardly weigh in training (`loss.kl`), and latents of real scenes fill only a few of their directions.
Gaussians that are fitted afterwards to the posterior means of training clips (ex-post density estimation, Ghosh et al.
2020) stay nearer to them. Neither uses labels.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from obpose.creation.origin import Origin
from obpose.errors import CorruptFile, UsageError
from obpose.files import write_whole
from obpose.model import ObPose
from obpose.types import Observation

FILE = "prior.safetensors"
"""Beside the model's weights."""
_WEIGHTS = "weights"
"""In the file's metadata: SHA-256 of the file of the weights that it was fitted to."""
_AGAIN = "make it again with obpose-edit fit, or give --prior learned."
_MARGIN = 0.02
"""Share of the objects at each end that do not say how far from the middle they are found."""


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A normal distribution."""

    mean: Float[Tensor, "latent"]
    factor: Float[Tensor, "latent latent"]
    """The covariance is factor factor^T."""

    def draw(self, count: int, generator: torch.Generator) -> Float[Tensor, "count latent"]:
        """Independent samples."""
        return self.mean + torch.randn(count, len(self.mean), generator=generator) @ self.factor.T


@dataclass(frozen=True, eq=False)
class ScenePrior:
    """Of the latents of the first frame, and the part of the table on which objects stand."""

    what: Gaussian
    background: Gaussian
    low: Float[Tensor, "2"]
    """Of the objects' middles, world x and y, metres."""
    high: Float[Tensor, "2"]


def learned_prior(model: ObPose) -> ScenePrior:
    """The model's own (paper, section Object Location and Orientation Conditioned Encoding).

    It says nothing of where objects are; they are put in the middle half of the workspace.
    """
    assert model.background is not None
    half = model.config.model.workspace_size / 4
    middle = model.center[:2]
    gaussians = (Gaussian(mean, torch.diag(std)) for mean, std in (model.what.first(), model.background.first()))
    return ScenePrior(*gaussians, low=middle - half, high=middle + half)


@torch.no_grad()
def fit_prior(model: ObPose, clips: Iterable[Observation]) -> ScenePrior:
    """Gaussians of the posterior means of the first frames of clips, a batch of one each.

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
        raise UsageError(f"{len(objects)} objects were found in {scenes} clips; expected at least 2 in 2 clips.")
    places = torch.cat(center)
    low, high = (torch.quantile(places, share, dim=0) for share in (_MARGIN, 1 - _MARGIN))
    return ScenePrior(_gaussian(objects), _gaussian(torch.stack(background)), low, high)


def save_prior(origin: Origin, prior: ScenePrior) -> None:
    """Write what `load_prior` reads beside a model's weights, with their hash: to other weights it means nothing."""
    tensors = {
        "what.mean": prior.what.mean,
        "what.factor": prior.what.factor,
        "background.mean": prior.background.mean,
        "background.factor": prior.background.factor,
        "low": prior.low,
        "high": prior.high,
    }
    contents = {name: tensor.contiguous() for name, tensor in tensors.items()}
    write_whole(origin.folder / FILE, save(contents, metadata={_WEIGHTS: origin.hash}))


def load_prior(origin: Origin) -> ScenePrior:
    """The prior that was fitted to a model.

    Raises:
        UsageError: there is none.
        CorruptFile: the file is damaged, or another model's.
    """
    path = origin.folder / FILE
    if not path.is_file():
        raise UsageError(f"{origin.folder} has no {FILE}; make one with obpose-edit fit, or give --prior learned.")
    try:
        with safe_open(path, framework="pt") as file:
            found = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
            weights = (file.metadata() or {}).get(_WEIGHTS)
        prior = ScenePrior(
            Gaussian(found["what.mean"], found["what.factor"]),
            Gaussian(found["background.mean"], found["background.factor"]),
            found["low"],
            found["high"],
        )
    except (SafetensorError, KeyError, TypeError, ValueError):
        raise CorruptFile(f"{path} is damaged; {_AGAIN}") from None
    if weights is None:
        raise CorruptFile(f"{path} does not say which weights it was fitted to, as older ones; {_AGAIN}")
    if weights != origin.hash:
        raise CorruptFile(f"{path} was fitted to other weights than those beside it; {_AGAIN}")
    if not _is_whole(prior, origin.model):
        raise CorruptFile(f"{path} is damaged; {_AGAIN}")
    return prior


def _is_whole(prior: ScenePrior, model: ObPose) -> bool:
    latent = model.config.model.latent
    sizes = {prior.what: latent.what, prior.background: latent.background}
    values = [prior.low, prior.high, *(value for one in sizes for value in (one.mean, one.factor))]
    return (
        all(one.mean.shape == (size,) and one.factor.shape == (size, size) for one, size in sizes.items())
        and prior.low.shape == prior.high.shape == (2,)
        and all(value.dtype == torch.float32 and bool(value.isfinite().all()) for value in values)
    )


def _gaussian(values: Float[Tensor, "n latent"]) -> Gaussian:
    """By the principal axes, as there may be fewer values than dimensions."""
    mean = values.mean(dim=0)
    _, spread, axes = torch.linalg.svd(values - mean, full_matrices=False)
    factor = torch.zeros(values.shape[1], values.shape[1])
    factor[:, : len(spread)] = axes.T * (spread / (len(values) - 1) ** 0.5)
    return Gaussian(mean, factor)
