"""All loss terms of a step and their weighted sum (paper, section Training: L = L_obs + L_att + L_others)."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from obpose.attention.upsample import masks_at
from obpose.config import LossConfig
from obpose.losses import observation
from obpose.losses.attention import attention_l2, attention_mixture, attention_warmup
from obpose.losses.regularisers import kl, remaining_scope, translation
from obpose.nerf.compose import log_share
from obpose.types import Decoded, Embeddings, Inference, Latent, Rays, Shape


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the losses compare; without `inference` only the background and the pre-scope are trained."""

    rays: Rays
    surface: Decoded
    """At the observed surface, with colours."""
    air: Decoded
    """Before it."""
    inverse_rho: Float[Tensor, "batch frame ray"]
    """Of the points in the air, metres."""
    background: Latent
    embeddings: Embeddings
    log_prescope: Float[Tensor, "batch frame point 2"]
    grid: tuple[int, int, int]
    """Views, rows and columns of the embedding grid."""
    size: tuple[int, int]
    """Height and width of the images."""
    inference: Inference | None = None
    shape: Shape | None = None
    """T_shape; None without pose conditioning."""


def loss_terms(evidence: Evidence, config: LossConfig) -> dict[str, Tensor]:
    """The unweighted terms by name, detached, and `total`, to be minimised."""
    weights = {
        "colour": config.colour,
        "surface": config.surface,
        "air": config.air,
        "attention": config.mask,
        "scope": config.scope,
        "translation": config.translation,
        "kl_background": config.kl,
        "kl_what": config.kl,
        "kl_where": config.kl_where,
    }
    terms = _observation_terms(evidence, config)
    if evidence.inference is None:
        terms["attention"] = _warmup_attention(evidence, config)
    else:
        terms |= _object_terms(evidence, evidence.inference, config)
    total = sum((weights[name] * term for name, term in terms.items()), start=terms["surface"].new_zeros(()))
    return {"total": total, **{name: term.detach() for name, term in terms.items()}}


def _observation_terms(evidence: Evidence, config: LossConfig) -> dict[str, Tensor]:
    weight = evidence.rays.weight
    return {
        "colour": observation.colour_mixture(log_share(evidence.surface.logits), _likelihood(evidence, config), weight),
        "surface": observation.surface(evidence.surface.logits, weight, sigma_max=config.sigma_max),
        "air": observation.air(evidence.air.logits, evidence.inverse_rho, weight, sigma_max=config.sigma_max),
        "kl_background": kl(evidence.background),
    }


def _object_terms(evidence: Evidence, inference: Inference, config: LossConfig) -> dict[str, Tensor]:
    masks, active = inference.masks, inference.masks.active
    terms = {
        "attention": _attention(evidence, inference, config),
        "scope": remaining_scope(masks.log_scope, evidence.embeddings.valid),
        "kl_what": kl(inference.what, active[:, None]),
    }
    if inference.where is not None and evidence.shape is not None:
        shape = evidence.shape
        terms["translation"] = translation(inference.boxes.center, shape.center, shape.found, active)
        terms["kl_where"] = kl(inference.where, active[:, None])
    return terms


def _warmup_attention(evidence: Evidence, config: LossConfig) -> Tensor:
    log_prescope = _at_rays(evidence, evidence.log_prescope.mT)
    return attention_warmup(log_prescope, _likelihood(evidence, config), evidence.rays.weight, unknown=config.unknown)


def _at_rays(evidence: Evidence, log_masks: Tensor) -> Tensor:
    return masks_at(log_masks, evidence.embeddings.valid, evidence.rays.index, grid=evidence.grid, size=evidence.size)


def _attention(evidence: Evidence, inference: Inference, config: LossConfig) -> Tensor:
    log_masks = _at_rays(evidence, inference.masks.log_masks)
    likelihood, share = _likelihood(evidence, config), log_share(evidence.surface.logits)
    if config.attention == "l2":
        return attention_l2(log_masks, likelihood, share, evidence.rays.weight, std=config.colour_std)
    return attention_mixture(log_masks, likelihood, share, evidence.rays.weight, floor=config.attention_floor)


def _likelihood(evidence: Evidence, config: LossConfig) -> Tensor:
    assert evidence.surface.colours is not None
    return observation.log_likelihood(
        evidence.surface.colours,
        evidence.rays.colour,
        std=config.colour_std,
        likelihood=config.colour_likelihood,
    )
