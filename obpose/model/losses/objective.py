"""All loss terms of a step and their weighted sum (paper, section Training: L = L_obs + L_att + L_others)."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from obpose.config import LossConfig
from obpose.model.attention.upsample import masks_at
from obpose.model.losses import observation
from obpose.model.losses.attention import attention_l2, attention_mixture, attention_warmup
from obpose.model.losses.regularisers import kl, remaining_scope, translation
from obpose.model.nerf.along import FieldsAlongRays
from obpose.model.nerf.compose import log_share
from obpose.types import Embeddings, Inference, Latent, Shape


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the losses compare; without `inference` only the background and the pre-scope are trained."""

    fields: FieldsAlongRays
    """Along rays of pixels that have masks."""
    background: Latent | None
    embeddings: Embeddings
    log_prescope: Float[Tensor, "batch frame point 2"] | None
    grid: tuple[int, int, int]
    """Views, rows and columns of the embedding grid."""
    size: tuple[int, int]
    """Height and width of the images."""
    inference: Inference | None = None
    shape: Shape | None = None
    """T_shape; None without pose conditioning."""
    beyond: FieldsAlongRays | None = None
    """Along rays of views that have no masks, which count as much as the others; None without such views."""


def loss_terms(evidence: Evidence, config: LossConfig, *, fraction: float) -> dict[str, Tensor]:
    """The unweighted terms by name, detached, and `total`, to be minimised at this fraction of the budget."""
    weights = {
        "colour": config.colour,
        "surface": config.surface,
        "air": config.air * growth(config.air_growth, fraction),
        "attention": config.mask,
        "scope": config.scope,
        "translation": config.translation,
        "kl_background": config.kl,
        "kl_what": config.kl,
        "kl_where": config.kl_where,
    }
    terms = _all_observation_terms(evidence, config)
    if evidence.inference is not None:
        terms |= _object_terms(evidence, evidence.inference, config)
    elif evidence.log_prescope is not None:
        terms["attention"] = _warmup_attention(evidence, evidence.log_prescope, config)
    total = sum((weights[name] * term for name, term in terms.items()), start=terms["surface"].new_zeros(()))
    return {"total": total, **{name: term.detach() for name, term in terms.items()}}


def growth(most: float, fraction: float) -> float:
    """1 in the first half of the budget, then growing by equal factors to `most` at three quarters of it.

    >>> [growth(100.0, fraction) for fraction in (0.0, 0.5, 0.625, 0.75, 1.0)]
    [1.0, 1.0, 10.0, 100.0, 100.0]
    """
    return most ** min(1.0, max(0.0, 4 * fraction - 2))


def _all_observation_terms(evidence: Evidence, config: LossConfig) -> dict[str, Tensor]:
    terms = observation_terms(evidence.fields, config)
    if evidence.beyond is not None:
        others = observation_terms(evidence.beyond, config)
        terms = {name: (term + others[name]) / 2 for name, term in terms.items()}
    return terms if evidence.background is None else terms | {"kl_background": kl(evidence.background)}


def observation_terms(fields: FieldsAlongRays, config: LossConfig) -> dict[str, Tensor]:
    """The three terms of L_obs along these rays, unweighted (paper, section Training)."""
    weight, logits = fields.rays.weight, fields.surface.logits
    return {
        "colour": observation.colour_mixture(log_share(logits), _likelihood(fields, config), weight),
        "surface": observation.surface(logits, weight, sigma_max=config.sigma_max),
        "air": observation.air(
            fields.air.logits,
            fields.inverse_rho,
            weight,
            sigma_max=config.sigma_max,
            saturation=config.air_saturation,
        ),
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


def _warmup_attention(evidence: Evidence, log_prescope: Tensor, config: LossConfig) -> Tensor:
    at_rays, weight = _at_rays(evidence, log_prescope.mT), evidence.fields.rays.weight
    return attention_warmup(at_rays, _likelihood(evidence.fields, config), weight, unknown=config.unknown)


def _at_rays(evidence: Evidence, log_masks: Tensor) -> Tensor:
    index = evidence.fields.rays.index
    return masks_at(log_masks, evidence.embeddings.valid, index, grid=evidence.grid, size=evidence.size)


def _attention(evidence: Evidence, inference: Inference, config: LossConfig) -> Tensor:
    log_masks = _at_rays(evidence, inference.masks.log_masks)
    fields = evidence.fields
    likelihood, share, weight = _likelihood(fields, config), log_share(fields.surface.logits), fields.rays.weight
    if config.attention == "l2":
        return attention_l2(log_masks, likelihood, share, weight, std=config.colour_std)
    return attention_mixture(log_masks, likelihood, share, weight, floor=config.attention_floor)


def _likelihood(fields: FieldsAlongRays, config: LossConfig) -> Tensor:
    colours = fields.surface.colours
    assert colours is not None
    return observation.log_likelihood(
        colours,
        fields.rays.colour,
        std=config.colour_std,
        likelihood=config.colour_likelihood,
    )
