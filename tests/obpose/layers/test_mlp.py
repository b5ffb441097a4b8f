import torch
from torch import nn

from obpose.layers.mlp import mlp


def test_elu_stands_between_layers_and_not_after_the_last():
    layers = mlp(3, 5, 7, 2)
    assert [type(layer) for layer in layers] == [nn.Linear, nn.ELU, nn.Linear, nn.ELU, nn.Linear]
    assert layers(torch.zeros(4, 3)).shape == (4, 2)


def test_two_sizes_are_one_linear_map():
    layer = mlp(3, 2)
    x, y = torch.randn(2, 5, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(layer(x) - layer(y), layer(x - y) - layer(torch.zeros(5, 3)))
