from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from obpose.errors import CorruptFile, UsageError
from obpose.scenes.model_ref import Origin, load_origin
from obpose.scenes.priors.flow import Flow
from obpose.scenes.priors.flow_prior import has_flow, load_flow, save_flow
from obpose.scenes.priors.gaussian import learned_prior, save_prior
from obpose.storage.pretrained import shipped_names
from tests.obpose.scenes.small_scenes import some_model, some_tables


@pytest.fixture
def origin(tmp_path: Path) -> Origin:
    """A model beside whose weights there is a prior."""
    origin = Origin(some_model(), tmp_path, "name", "hash")
    save_prior(origin, replace(learned_prior(origin.model), tables=some_tables()))
    return origin


def some_flow(latent: int = 32) -> Flow:
    torch.manual_seed(0)
    return Flow(latent)


def test_a_stored_flow_is_the_same_in_half_precision(origin: Origin):
    assert not has_flow(origin)
    with pytest.raises(UsageError, match="make one with obpose-edit learn"):
        load_flow(origin)
    flow = some_flow()
    path = save_flow(origin, flow)
    assert has_flow(origin)
    found = load_flow(origin)
    for name, value in flow.state_dict().items():
        assert torch.equal(found.flow.state_dict()[name], value.half().float())
    assert path.stat().st_size < 8_000_000
    assert not any(parameter.requires_grad for parameter in found.flow.parameters())
    assert torch.equal(found.tables.lights, some_tables().lights)
    torch.testing.assert_close(found.low, learned_prior(origin.model).low)


def test_a_flow_is_of_the_weights_that_found_its_objects(origin: Origin):
    save_flow(origin, some_flow())
    other = replace(origin, hash="another")
    save_prior(other, learned_prior(origin.model))
    with pytest.raises(CorruptFile, match="is of other weights than those beside it; make it again"):
        load_flow(other)


def test_damaged_flows_are_refused(origin: Origin):
    path = save_flow(origin, some_flow(latent=31))
    with pytest.raises(CorruptFile, match=r"is damaged .code is float16"):
        load_flow(origin)
    save_flow(origin, some_flow())
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(CorruptFile, match=r"is damaged .*make it again with obpose-edit learn"):
        load_flow(origin)
    save_flow(origin, some_flow())
    values = load_file(path)
    infinite = values["norm.weight"].clone()
    infinite[3] = torch.inf
    for change, message in (
        ({"norm.weight": infinite}, "norm.weight holds NaN or infinity"),
        ({"norm.weight": values["norm.weight"].float()}, "norm.weight is float32"),
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


@pytest.mark.parametrize("name", shipped_names())
def test_flows_that_ship_are_of_the_weights_beside_them(name: str):
    origin = load_origin(name)
    if has_flow(origin):
        assert load_flow(origin).flow.code.isfinite().all()
