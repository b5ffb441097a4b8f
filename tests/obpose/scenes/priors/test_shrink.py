from dataclasses import replace
from pathlib import Path

import torch

from obpose.scenes.model_ref import load_origin
from obpose.scenes.priors import available_priors, load_prior
from obpose.scenes.priors.flow import Flow
from obpose.scenes.priors.flow_prior import save_flow
from obpose.scenes.priors.gaussian import learned_prior, save_gaussian
from obpose.scenes.priors.shrink import shrink_checkpoint
from obpose.storage.checkpoint import save_model
from tests.obpose.scenes.small_scenes import some_model, some_tables


def test_a_shrunk_checkpoint_is_smaller_and_keeps_its_priors(tmp_path: Path):
    model = some_model()
    save_model(tmp_path, model.state_dict(), model.config, {"steps": 3})
    origin = load_origin(str(tmp_path))
    save_gaussian(origin, replace(learned_prior(origin), tables=some_tables()))
    save_flow(origin, Flow(32))
    before = (tmp_path / "model.safetensors").stat().st_size
    shrink_checkpoint(tmp_path)
    assert (tmp_path / "model.safetensors").stat().st_size < 0.6 * before
    shrunk = load_origin(str(tmp_path))
    assert shrunk.hash != origin.hash
    assert available_priors(shrunk) == ["flow", "gaussian", "learned"]
    assert load_prior(shrunk).tables.lights.shape == (2, 4)
    for name, value in shrunk.model.state_dict().items():
        assert value.dtype == torch.float32
        torch.testing.assert_close(value, origin.model.state_dict()[name], rtol=1e-3, atol=1e-6)
