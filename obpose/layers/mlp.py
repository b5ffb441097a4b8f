"""The small networks that heads, encoders and latents end in."""

from itertools import pairwise

from torch import nn


def mlp(*sizes: int) -> nn.Sequential:
    """Linear layers of these widths with ELU between them, none after the last.

    The paper says MLP without more; the authors' is always Linear-ELU-Linear.
    """
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.ELU(), nn.Linear(inputs, outputs)]
    return nn.Sequential(*layers[1:])
