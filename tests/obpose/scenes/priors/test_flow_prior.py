from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from obpose.errors import CorruptFile, UsageError
from obpose.scenes.model_ref import Origin, load_origin
from obpose.scenes.priors import available_priors
from obpose.scenes.priors.flow import Flow
from obpose.scenes.priors.flow_prior import FlowObjects, load_flow, save_flow
from obpose.scenes.priors.gaussian import learned_prior, save_gaussian
from tests.obpose.scenes.small_scenes import some_model, some_tables


@pytest.fixture
def origin(tmp_path: Path) -> Origin:
    """A model beside whose weights there is a prior."""
    origin = Origin(some_model(), tmp_path, "name", "hash")
    save_gaussian(origin, replace(learned_prior(origin), tables=some_tables()))
    return origin


def some_flow(latent: int = 32) -> Flow:
    torch.manual_seed(0)
    return Flow(latent)


def test_a_stored_flow_is_the_same_to_its_precision(origin: Origin):
    assert available_priors(origin) == ["gaussian", "learned"]
    with pytest.raises(UsageError, match="make one with obpose-edit fit-prior --kind flow"):
        load_flow(origin)
    flow = some_flow()
    path = save_flow(origin, flow)
    assert available_priors(origin)[0] == "flow"
    found = load_flow(origin)
    assert isinstance(found.objects, FlowObjects)
    for name, value in flow.state_dict().items():
        largest = float(value.abs().max())
        torch.testing.assert_close(found.objects.flow.state_dict()[name], value, rtol=0, atol=max(largest, 1e-6) / 250)
    assert path.stat().st_size < 4_000_000
    assert not any(parameter.requires_grad for parameter in found.objects.flow.parameters())
    torch.testing.assert_close(found.tables.lights, some_tables().lights, rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(found.low, learned_prior(origin).low, rtol=1e-3, atol=0)


def test_a_flow_is_of_the_weights_that_found_its_objects(origin: Origin):
    save_flow(origin, some_flow())
    other = replace(origin, hash="another")
    save_gaussian(other, learned_prior(origin))
    with pytest.raises(CorruptFile, match="was fitted to other weights than those beside it; make it again"):
        load_flow(other)


def test_damaged_flows_are_refused(origin: Origin):
    path = save_flow(origin, some_flow(latent=31))
    with pytest.raises(CorruptFile, match=r"is damaged .code is float32 of shape \[31\]"):
        load_flow(origin)
    save_flow(origin, some_flow())
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(CorruptFile, match=r"is damaged .*make it again with obpose-edit fit-prior --kind flow"):
        load_flow(origin)
    save_flow(origin, some_flow())
    values = load_file(path)
    infinite = values["norm.weight"].clone()
    infinite[3] = torch.inf
    for change, message in (
        ({"norm.weight": infinite}, "norm.weight holds NaN or infinity"),
        ({"norm.weight": values["norm.weight"].double()}, "norm.weight is float64"),
        ({"leave.weight.step": None}, "leave.weight is int8"),
        ({"norm.weight": None}, "norm.weight is missing"),
        ({"more": torch.zeros(1)}, "more is unknown"),
    ):
        changed = {name: value for name, value in {**values, **change}.items() if value is not None}
        save_file(changed, path, metadata={"weights": origin.hash})
        with pytest.raises(CorruptFile, match=f"is damaged .{message}.*; make it again"):
            load_flow(origin)


def test_it_needs_the_prior_of_all_else(origin: Origin):
    save_flow(origin, some_flow())
    (origin.folder / "prior.safetensors").unlink()
    with pytest.raises(UsageError, match=r"has no prior\.safetensors"):
        load_flow(origin)


@pytest.mark.parametrize("count", [0, 1])
def test_the_flow_that_ships_is_of_the_weights_beside_it(count: int):
    origin = load_origin("obpose-contact--moving--64x64")
    drawn = load_flow(origin).objects.draw(origin.model, count, torch.Generator())
    assert drawn.what.isfinite().all()
    assert len(drawn.what) == len(drawn.appearance.detail) == count
