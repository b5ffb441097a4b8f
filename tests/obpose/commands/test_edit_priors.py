"""Sampling and priors of the command, with the weights that ship."""

import shutil
from functools import partial
from pathlib import Path

import pytest
import torch

import assets
from datagen.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_USAGE
from datagen.pipeline.generate import generate
from obpose.commands import edit
from obpose.model.layers.latent import LATENT
from obpose.scenes.model_ref import load_origin
from obpose.scenes.priors import train_flow
from obpose.scenes.priors.flow_prior import save_flow
from obpose.scenes.priors.gaussian import learned_prior, load_gaussian, save_gaussian
from obpose.scenes.priors.interface import FitSettings
from obpose.scenes.scene import Scene
from obpose.scenes.storage import load_scene
from tests.obpose.commands.test_edit import MODEL, SMALL, run
from tests.obpose.scenes.small_scenes import dense_flow, equal
from tests.worlds import generated


@pytest.fixture(scope="module")
def own_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of weights that ship, beside which files may be written, with a Gaussian prior."""
    folder = tmp_path_factory.mktemp("models") / "own"
    shutil.copytree(assets.CHECKPOINTS / MODEL, folder)
    origin = load_origin(str(folder))
    save_gaussian(origin, learned_prior(origin))
    return folder


def test_scenes_are_sampled_as_prior_and_seed_say(inferred: Path, own_model: Path, tmp_path: Path):
    def sample(out: str, *flags: object) -> Scene:
        command = ("sample", "--checkpoint", own_model, "--camera", inferred, "--objects", 2, "--seed", 3)
        assert run(*command, *SMALL, *flags, "--out", tmp_path / out) == EXIT_OK
        return load_scene(tmp_path / out)

    # The best prior that there is, is the default.
    gaussian = sample("one")
    assert gaussian.ids == (1, 2)
    assert not gaussian.appearance.detail.any()
    assert equal(gaussian, sample("again", "--prior", "gaussian"))
    assert (tmp_path / "one" / "picture.png").read_bytes() == (tmp_path / "again" / "picture.png").read_bytes()
    assert not equal(gaussian, sample("learned", "--prior", "learned"))
    save_flow(load_origin(str(own_model)), dense_flow(LATENT))
    flow = sample("flow")
    assert flow.appearance.detail.flatten(1).any(dim=1).all()
    assert equal(flow, sample("flow again", "--prior", "flow"))
    # Without a scene there is a camera of the program's.
    flags = ["--checkpoint", own_model, "--objects", 0, "--prior", "gaussian", *SMALL]
    assert run("sample", *flags, "--out", tmp_path / "empty") == EXIT_OK
    assert (load_scene(tmp_path / "empty").cameras[0].width, len(load_scene(tmp_path / "empty").ids)) == (128, 0)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clips to fit priors to."""
    folder = tmp_path_factory.mktemp("clips") / "data"
    generate(folder, generated.recipe(frames=2), splits={"train": 2}, resolution=(64, 64))
    return folder


def test_a_prior_is_fitted_beside_the_weights_and_takes_no_other_one_s_place(
    own_model: Path, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(edit, "FitSettings", partial(FitSettings, refinements=1))
    folder = tmp_path / "own"
    shutil.copytree(own_model, folder)
    before = (folder / "prior.safetensors").read_bytes()
    assert run("fit-prior", "--checkpoint", folder, "--data", data) == EXIT_USAGE
    assert "prior.safetensors exists; move it elsewhere" in capsys.readouterr().err
    assert (folder / "prior.safetensors").read_bytes() == before
    (folder / "prior.safetensors").unlink()
    assert run("fit-prior", "--checkpoint", folder, "--data", data, "--clips", 3) == EXIT_OK
    told = capsys.readouterr().out
    assert "has 2 training clips, fewer than --clips 3" in told
    assert "Fitted to 2 clips" in told
    assert len(load_gaussian(load_origin(str(folder))).tables.lights) == 2


def test_a_flow_is_learned_beside_the_weights(
    own_model: Path, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    small = partial(FitSettings, refinements=1, least_objects=1, batch=4, compared=8)
    monkeypatch.setattr(edit, "FitSettings", small)
    folder = tmp_path / "own"
    shutil.copytree(own_model, folder, ignore=shutil.ignore_patterns("flow.safetensors"))
    flags = ["--checkpoint", folder, "--data", data, "--workers", 1]
    assert run("fit-prior", "--kind", "flow", *flags, "--steps", 0) == EXIT_USAGE
    assert "--steps 0: expected 1 to" in capsys.readouterr().err
    assert run("fit-prior", "--kind", "flow", *flags, "--seed", -1) == EXIT_USAGE
    assert "--seed -1: expected 0 to" in capsys.readouterr().err
    assert run("fit-prior", "--kind", "flow", *flags, "--clips", 1) == EXIT_USAGE
    assert "--clips 1: expected 2 or more, of the training split" in capsys.readouterr().err
    assert run("fit-prior", "--kind", "flow", *flags[:4], "--workers", 0) == EXIT_USAGE
    assert "--workers 0: expected at least 1" in capsys.readouterr().err
    with monkeypatch.context() as patch:
        patch.setattr(train_flow, "flow_loss", interrupting)
        assert run("fit-prior", "--kind", "flow", *flags, "--steps", 1) == EXIT_INTERRUPTED
    assert "what was done is kept, and the same command resumes" in capsys.readouterr().err
    assert run("fit-prior", "--kind", "flow", *flags, "--steps", 1) == EXIT_OK
    assert "Looking for objects in 0 clips" in (said := capsys.readouterr().out)
    assert "Fitted to 2 clips" in said
    assert (folder / "flow.safetensors").is_file()
    assert run("fit-prior", "--kind", "flow", *flags, "--steps", 1) == EXIT_USAGE
    assert "flow.safetensors exists; move it elsewhere" in capsys.readouterr().err
    (folder / "flow.safetensors").unlink()
    (folder / "prior.safetensors").unlink()
    assert run("fit-prior", "--kind", "flow", *flags, "--steps", 1) == EXIT_USAGE
    assert "make one with obpose-edit fit-prior --kind gaussian first" in capsys.readouterr().err


def interrupting(*_: object) -> torch.Tensor:
    raise KeyboardInterrupt
