"""Masks from the fields that were read under other masks: the E-step of the mixture that the fields are (our addition).

An attention mask knows nothing of what the fields make of its points. A point at a border, or of an object that two
masks share, is explained by one of them better than by the other, in density or in colour.
"""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from obpose.model.attention.icsbp import EXCLUDED
from obpose.model.nerf.compose import log_share
from obpose.types import Masks


def posterior_masks(
    masks: Masks,
    logits: Float[Tensor, "batch frame component point"],
    log_likelihood: Float[Tensor, "batch frame component point"],
    valid: Bool[Tensor, "batch frame point"],
) -> Masks:
    """Masks m_k in proportion to sigma_hat_k N(x | c_k), from density logits and colours' log likelihoods.

    That is the posterior of the mixture in the first term of L_obs (paper, section Training), the colour channels
    together. Nothing is left over; points that are not valid are the background's, whose component is the first.
    """
    posterior = (log_share(logits) + log_likelihood).log_softmax(dim=2).clamp(min=EXCLUDED)
    nobody = torch.full_like(posterior, EXCLUDED)
    nobody[:, :, 0] = 0
    return replace(
        masks,
        log_masks=torch.where(valid[:, :, None], posterior, nobody),
        log_scope=torch.full_like(masks.log_scope, EXCLUDED),
    )
