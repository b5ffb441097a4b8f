"""Masks as posteriors, given the fields that were inferred under earlier masks (our addition).

Attention masks do not depend on what the fields make of their points. Points at a border, or of an object that two
masks share, are explained better by one of the fields, in density or in colour. This is an E-step of their mixture.
"""

from dataclasses import replace

import torch

from obpose.model.attention.interface import EXCLUDED
from obpose.model.nerf.compose import log_share
from obpose.types import ComponentMasks, GridValid, Masks


def posterior_masks(masks: Masks, logits: ComponentMasks, log_likelihood: ComponentMasks, valid: GridValid) -> Masks:
    """Masks m_k in proportion to sigma_hat_k N(x | c_k), from density logits and log-likelihoods of the colours.

    This is the posterior of the mixture in the first term of L_obs (paper, section Training), with one likelihood for
    all colour channels. No scope remains. Invalid points belong to the background, which is the first component.
    """
    posterior = (log_share(logits) + log_likelihood).log_softmax(dim=2).clamp(min=EXCLUDED)
    nobody = torch.full_like(posterior, EXCLUDED)
    nobody[:, :, 0] = 0
    return replace(
        masks,
        log_masks=torch.where(valid[:, :, None], posterior, nobody),
        log_scope=torch.full_like(masks.log_scope, EXCLUDED),
    )
