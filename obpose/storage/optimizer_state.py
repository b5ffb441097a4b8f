"""The state of Adam as tensors by `parameter.value`, as checkpoints hold it."""

from typing import Any

import torch
from torch import nn

from obpose.storage.tensors import Form, Forms, State, differences_of, forms_of

_MOMENTS, _COUNT = ("exp_avg", "exp_avg_sq"), "step"


def optimizer_state(module: nn.Module, optimizer: Any) -> State:
    """Give the state of Adam for the parameters of a module; those that had no gradient yet have none."""
    return {
        f"{name}.{value}": tensor
        for name, parameter in module.named_parameters()
        for value, tensor in optimizer.state.get(parameter, {}).items()
    }


def put_optimizer_state(module: nn.Module, optimizer: Any, state: State) -> None:
    """Load what `optimizer_state` gave into Adam.

    The optimiser is Adam or AdamW, perhaps wrapped by Lightning Fabric, for the parameters of the module in their
    order.

    Raises:
        ValueError: names, types or shapes are not those of Adam for these parameters, or values are impossible.
    """
    parameters = dict(module.named_parameters())
    begun = {name.rpartition(".")[0] for name in state}
    expected: Forms = {}
    for name in begun & parameters.keys():
        form = Form(parameters[name].dtype, tuple(parameters[name].shape))
        expected |= {f"{name}.{value}": form for value in _MOMENTS} | {f"{name}.{_COUNT}": Form(torch.float32, ())}
    if wrong := differences_of(forms_of(state), expected):
        raise ValueError(wrong)
    for name, tensor in state.items():
        if not name.endswith(f".{_MOMENTS[0]}") and not bool((tensor >= 0).all()):
            raise ValueError(f"{name} has values below 0")
    places = {name: place for place, name in enumerate(parameters)}
    values: dict[int, State] = {}
    for name, tensor in state.items():
        parameter, _, value = name.rpartition(".")
        values.setdefault(places[parameter], {})[value] = tensor
    groups = optimizer.state_dict()["param_groups"]
    optimizer.load_state_dict({"state": values, "param_groups": groups})
