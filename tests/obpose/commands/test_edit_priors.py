"""Sampling and priors of the command, with the weights that ship."""

import shutil
from pathlib import Path

import pytest
import torch

import assets
from datagen.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_USAGE
from datagen.pipeline.generate import generate
from obpose.model.layers.latent import LATENT
from obpose.scenes.model_ref import load_origin
from obpose.scenes.priors import examples, gaussian, train_flow
from obpose.scenes.priors.flow_prior import save_flow
from obpose.scenes.priors.gaussian import load_gaussian, save_gaussian
from obpose.scenes.priors.learned import learned_prior
from obpose.scenes.storage import load_scene
from tests.obpose.commands.test_edit import MODEL, run
from tests.obpose.scenes.small_scenes import dense_flow, equal
from tests.worlds import generated


@pytest.mark.parametrize("prior", ["learned", "gaussian"])
def test_a_scene_is_sampled_as_its_seed_says(inferred: Path, own_model: Path, tmp_path: Path, prior: str):
    for out in ("one", "again"):
        flags = ["--checkpoint", own_model, "--camera", inferred, "--prior", prior, "--seed", 3, "--objects", 2]
        assert run("sample", *flags, "--out", tmp_path / out) == EXIT_OK
    one, again = load_scene(tmp_path / "one"), load_scene(tmp_path / "again")
    assert one.ids == (1, 2)
    assert torch.equal(one.what, again.what)
    assert (tmp_path / "one" / "picture.png").read_bytes() == (tmp_path / "again" / "picture.png").read_bytes()


@pytest.fixture(scope="module")
def own_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of weights that ship, beside which files may be written, with a Gaussian prior."""
    folder = tmp_path_factory.mktemp("models") / "own"
    shutil.copytree(assets.CHECKPOINTS / MODEL, folder)
    origin = load_origin(str(folder))
    save_gaussian(origin, learned_prior(origin))
    return folder


def test_a_flow_is_what_scenes_are_sampled_from_where_there_is_one(
    inferred: Path, own_model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    origin = load_origin(str(own_model))
    flags = ["--checkpoint", own_model, "--camera", inferred, "--objects", 2]
    assert run("sample", *flags, "--out", tmp_path / "before") == EXIT_OK
    assert not load_scene(tmp_path / "before").appearance.detail.any()
    save_flow(origin, dense_flow(LATENT))
    for out in ("one", "again"):
        assert run("sample", *flags, "--prior", "flow", "--out", tmp_path / out) == EXIT_OK
    assert run("sample", *flags, "--out", tmp_path / "default") == EXIT_OK
    one, again, default = (load_scene(tmp_path / name) for name in ("one", "again", "default"))
    assert one.appearance.detail.flatten(1).any(dim=1).all()
    assert equal(one, again)
    assert equal(one, default)
    flags = ["--checkpoint", own_model, "--objects", 0]
    assert run("sample", *flags, "--prior", "gaussian", "--out", tmp_path / "fitted") == EXIT_OK
    assert (load_scene(tmp_path / "fitted").cameras[0].width, len(load_scene(tmp_path / "fitted").ids)) == (128, 0)
    flags = ["--checkpoint", own_model, "--camera", inferred, "--objects", 1]
    assert run("sample", *flags, "--prior", "gaussian", "--out", tmp_path / "gaussian") == EXIT_OK
    assert not load_scene(tmp_path / "gaussian").appearance.detail.any()


def test_a_prior_is_fitted_beside_the_weights_and_takes_no_other_one_s_place(
    own_model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(gaussian, "STEPS", 1)
    data, folder = tmp_path / "data", tmp_path / "own"
    generate(data, generated.recipe(frames=2), splits={"train": 2}, resolution=(64, 64))
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
    own_model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(examples, "STEPS", 1)
    monkeypatch.setattr(train_flow, "COMPARED", 8)
    monkeypatch.setattr(train_flow, "BATCH", 4)
    monkeypatch.setattr(train_flow, "_LEAST_OBJECTS", 1)
    data = tmp_path / "data"
    generate(data, generated.recipe(frames=2), splits={"train": 2}, resolution=(64, 64))
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
    monkeypatch.setattr(train_flow, "flow_loss", interrupting)
    assert run("fit-prior", "--kind", "flow", *flags, "--steps", 1) == EXIT_INTERRUPTED
    assert "what was done is kept, and the same command resumes" in capsys.readouterr().err
    monkeypatch.undo()
    monkeypatch.setattr(train_flow, "_LEAST_OBJECTS", 1)
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
