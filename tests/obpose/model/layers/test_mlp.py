import pytest
import torch
from torch import nn

from obpose.model.layers.mlp import Linear, pass_on


@pytest.mark.parametrize("bias", [True, False])
@pytest.mark.parametrize(("inputs", "outputs"), [(3, 16), (16, 3), (4, 4)])
def test_linear_layers_are_pytorchs(inputs: int, outputs: int, bias: bool):
    torch.manual_seed(0)
    ours, theirs = Linear(inputs, outputs, bias=bias).double(), nn.Linear(inputs, outputs, bias=bias).double()
    theirs.load_state_dict(ours.state_dict())
    x, sought = torch.randn(2, 50, inputs).double(), torch.randn(2, 50, outputs).double()
    found = []
    for layer in (ours, theirs):
        rows = x.clone().requires_grad_()
        out = layer(rows)
        out.backward(sought)
        found.append((out, rows.grad, *(parameter.grad for parameter in layer.parameters())))
    torch.testing.assert_close(*found)


def test_a_layer_that_passes_on_keeps_all_lengths_and_distances():
    torch.manual_seed(0)
    layer = nn.Linear(4, 9)
    pass_on(layer, gain=3.0)
    x, y = torch.randn(2, 20, 4)
    torch.testing.assert_close(layer(x).norm(dim=-1), 3 * x.norm(dim=-1))
    torch.testing.assert_close((layer(x) - layer(y)).norm(dim=-1), 3 * (x - y).norm(dim=-1))


def test_of_a_part_of_its_outputs_the_others_weights_stay():
    torch.manual_seed(0)
    layer = nn.Linear(4, 6)
    before = layer.weight.detach().clone()
    pass_on(layer, outputs=4)
    first, others = layer.weight.detach().split([4, 2])
    torch.testing.assert_close(first @ first.T, torch.eye(4))
    assert torch.equal(others, before[4:])
    assert layer.bias.eq(0).all()
