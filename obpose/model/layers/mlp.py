"""The small networks that heads, encoders and latents end in."""

from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


def mlp(*sizes: int, activation: type[nn.Module] = nn.ELU) -> nn.Sequential:
    """Linear layers of these widths with activations between them, none after the last.

    The paper says MLP without more; the authors' is always Linear-ELU-Linear.
    """
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [activation(), Linear(inputs, outputs)]
    return nn.Sequential(*layers[1:])


class Linear(nn.Linear):
    """PyTorch's, faster to train on a CPU where many rows with few inputs become wider.

    The gradient of its weight is a product of two tall matrices, which takes up to six times as long if the narrower
    one comes second. The order follows from how the weight lies in memory.
    """

    def forward(self, input: Float[Tensor, "*rows inputs"]) -> Float[Tensor, "*rows outputs"]:
        """A linear map of the last axis."""
        if self.in_features >= self.out_features:
            return super().forward(input)
        return F.linear(input, self.weight.t().contiguous().t(), self.bias)


def pass_on(layer: nn.Linear, *, gain: float = 1.0, outputs: int | None = None) -> None:
    """Make the weights of the layer, or of its first `outputs` outputs, orthogonal, and biases 0.

    PyTorch's own weights make what tells two inputs apart several times smaller. Through the layers on the way from an
    encoder to a decoder nothing is then left at the start of training, and decoders learn to do without the latent.
    """
    with torch.no_grad():
        fresh = torch.empty_like(layer.weight[:outputs])
        layer.weight[:outputs] = nn.init.orthogonal_(fresh, gain)
        if layer.bias is not None:
            layer.bias.zero_()
