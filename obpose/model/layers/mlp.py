"""Small networks at the ends of heads, encoders and latents."""

from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


def mlp(*sizes: int, activation: type[nn.Module] = nn.ELU) -> nn.Sequential:
    """Linear layers of these widths with activations between them.

    The paper does not specify its MLPs; the authors' code has Linear-ELU-Linear.
    """
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [activation(), Linear(inputs, outputs)]
    return nn.Sequential(*layers[1:])


class Linear(nn.Linear):
    """Linear layer that trains faster on a CPU if it widens many rows with few inputs.

    The gradient of its weight is a product of two tall matrices, which takes up to six times as long if the narrower
    one comes second. The memory layout of the weight decides their order.
    """

    def forward(self, input: Float[Tensor, "*rows inputs"]) -> Float[Tensor, "*rows outputs"]:
        """Map the last axis."""
        if self.in_features >= self.out_features:
            return super().forward(input)
        return F.linear(input, self.weight.t().contiguous().t(), self.bias)


def pass_on(layer: nn.Linear, *, gain: float = 1.0, outputs: int | None = None) -> None:
    """Make the weights of the layer, or of its first `outputs` outputs, orthogonal, and biases 0.

    PyTorch's own weights shrink the difference of two inputs several times in each layer. At the start of training
    nothing would be left of it between encoder and decoder, and decoders would learn to ignore the latent.
    """
    with torch.no_grad():
        fresh = torch.empty_like(layer.weight[:outputs])
        layer.weight[:outputs] = nn.init.orthogonal_(fresh, gain)
        if layer.bias is not None:
            layer.bias.zero_()
