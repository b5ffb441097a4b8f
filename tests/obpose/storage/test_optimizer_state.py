import pytest
import torch
from torch import Tensor, nn

from obpose.storage.optimizer_state import optimizer_state, put_optimizer_state


def trained(steps: int) -> tuple[nn.Linear, torch.optim.Adam]:
    """A module of which only the bias had a gradient."""
    torch.manual_seed(0)
    module = nn.Linear(2, 3)
    optimizer = torch.optim.Adam(module.parameters(), lr=0.1)
    for _ in range(steps):
        module.bias.grad = torch.ones(3)
        optimizer.step()
    return module, optimizer


def test_state_is_taken_over():
    module, optimizer = trained(3)
    state = {name: value.clone() for name, value in optimizer_state(module, optimizer).items()}
    assert state.keys() == {"bias.exp_avg", "bias.exp_avg_sq", "bias.step"}
    other, fresh = trained(0)
    put_optimizer_state(other, fresh, state)
    found = optimizer_state(other, fresh)
    assert found.keys() == state.keys()
    assert all(torch.equal(found[name], value) for name, value in state.items())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bias.step": None}, "bias.step is missing"),
        ({"bias.exp_avg": None}, "bias.exp_avg is missing"),
        ({"bias.more": torch.zeros(3)}, "bias.more is unknown"),
        ({"elsewhere.step": torch.zeros(())}, "elsewhere.step is unknown"),
        ({"step": torch.zeros(())}, "step is unknown"),
        ({"bias.exp_avg": torch.zeros(4)}, r"bias.exp_avg is float32 of shape \[4\]"),
        ({"bias.exp_avg": torch.zeros(3, dtype=torch.float64)}, "bias.exp_avg is float64"),
        ({"bias.step": torch.zeros((), dtype=torch.int64)}, "bias.step is int64"),
        ({"bias.step": torch.tensor(-1.0)}, "bias.step has values below 0"),
        ({"bias.exp_avg_sq": -torch.ones(3)}, "bias.exp_avg_sq has values below 0"),
    ],
)
def test_state_that_does_not_fit_is_refused(change: dict[str, Tensor | None], message: str):
    module, optimizer = trained(1)
    state = {
        name: value for name, value in {**optimizer_state(module, optimizer), **change}.items() if value is not None
    }
    with pytest.raises(ValueError, match=message):
        put_optimizer_state(*trained(0), state)
