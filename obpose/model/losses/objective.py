"""Weighted sum of all loss terms (paper, section Training: L = L_obs + L_att + L_others), and the terms of L_obs."""

from torch import Tensor

from obpose.config import LossConfig
from obpose.model.losses import observation
from obpose.model.nerf.along import FieldsAlongRays
from obpose.model.nerf.compose import log_share

SCOPE = 0.25
"""Weight of the scope loss. [paper: 1, with sums over the embedding grid, which has a quarter of the image's points]"""
KL = 1 / 4096
"""Weight of the KL divergence of z_what and z_bg. [paper: 1, with sums over rays]"""
KL_WHERE = 1e-3 * KL
"""Weight of the KL divergence of z_where. [code]"""


def weighted_terms(terms: dict[str, Tensor], config: LossConfig, *, fraction: float) -> dict[str, Tensor]:
    """Add `total`, the weighted sum at this fraction of the budget, to the terms, and detach these."""
    # Weights of L_obs, L_att and L_others.
    weights = {
        "colour": 1.0,
        "surface": 1.0,
        "air": growth(config.air_growth, fraction),
        "attention": config.attention_weight,
        "assignment": 1.0,
        "scope": SCOPE,
        "translation": config.translation,
        "kl_background": KL,
        "kl_what": KL,
        "kl_where": KL_WHERE,
    }
    total = sum((weights[name] * term for name, term in terms.items()), start=terms["surface"].new_zeros(()))
    return {"total": total, **{name: term.detach() for name, term in terms.items()}}


def growth(most: float, fraction: float) -> float:
    """Factor of 1 in the first half of the budget, growing exponentially to `most` at three quarters of it.

    >>> [growth(100.0, fraction) for fraction in (0.0, 0.5, 0.625, 0.75, 1.0)]
    [1.0, 1.0, 10.0, 100.0, 100.0]
    """
    return most ** min(1.0, max(0.0, 4 * fraction - 2))


def observation_terms(fields: FieldsAlongRays, config: LossConfig) -> dict[str, Tensor]:
    """Compute the three terms of L_obs along rays, unweighted (paper, section Training)."""
    weight, logits = fields.rays.weight, fields.surface.logits
    return {
        "colour": observation.colour_mixture(log_share(logits), observation.surface_likelihood(fields), weight),
        "surface": observation.surface(logits, weight),
        "air": observation.air(fields.air.logits, fields.inverse_rho, weight, saturation=config.air_saturation),
    }
