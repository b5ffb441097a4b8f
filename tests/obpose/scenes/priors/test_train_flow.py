import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

import assets
from datagen.pipeline.generate import generate
from obpose.errors import CorruptFile, Diverged, UsageError
from obpose.scenes.model_ref import Origin, load_origin
from obpose.scenes.priors import train_flow
from obpose.scenes.priors.examples import find_examples
from obpose.scenes.priors.flow import VALUES
from obpose.scenes.priors.flow_prior import load_flow
from obpose.scenes.priors.gaussian import learned_prior, save_gaussian
from obpose.scenes.priors.interface import FitSettings
from obpose.scenes.priors.train_flow import PARTIAL, fit_flow, nearest
from tests.worlds import generated

MODEL = "obpose--moving--64x64"
SMALL = {"refinements": 1, "least_objects": 6, "batch": 4, "save_steps": 2, "compared": 8}
SETTINGS = FitSettings(clips=4, steps=6, seed=0, workers=1, **SMALL)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("learn") / "data"
    generate(folder, generated.recipe(frames=3), splits={"train": 4}, resolution=(64, 64))
    return folder


@pytest.fixture(scope="module")
def found(data: Path) -> Path:
    """Folder with what is found in the clips, which takes most of the time."""
    folder = data.parent / "found"
    folder.mkdir()
    find_examples(load_origin(MODEL), data, folder, SETTINGS, print)
    return folder


def copied(folder: Path, found: Path) -> Origin:
    """Copy the model, with a prior of everything but objects, and with the objects that were found before."""
    shutil.copytree(assets.CHECKPOINTS / MODEL, folder)
    shutil.copytree(found, folder / PARTIAL)
    origin = load_origin(str(folder))
    save_gaussian(origin, learned_prior(origin))
    return origin


def learned(origin: Origin, data: Path, *, say: Callable[[str], None] = print, **settings: int) -> Path:
    return fit_flow(origin, data, replace(SETTINGS, **settings), say)


def stop_at(text: str) -> Callable[[str], None]:
    def say(line: str) -> None:
        if text in line:
            raise KeyboardInterrupt

    return say


def test_what_was_stopped_goes_on_to_the_same_end(data: Path, found: Path, tmp_path: Path):
    whole, parts = copied(tmp_path / "whole", found), copied(tmp_path / "parts", found)
    said: list[str] = []
    path = learned(whole, data, say=said.append)
    assert not (whole.folder / PARTIAL).exists()
    assert "Looking for objects in 0 clips" in said[0]
    (parts.folder / PARTIAL / "clip-00002.safetensors").unlink()
    for text in ("Learning from", "step 4 of 6"):
        with pytest.raises(KeyboardInterrupt):
            learned(parts, data, say=stop_at(text))
    said.clear()
    again = learned(parts, data, say=said.append)
    assert "Looking for objects in 0 clips" in said[0]
    assert [line.partition(":")[0] for line in said if line.startswith("step")] == ["step 6 of 6"]
    assert "median: samples" in said[-1]
    # The last digit of what is found may differ, as may that of what is learned from it.
    for name, value in load_file(path).items():
        torch.testing.assert_close(load_file(again)[name], value, atol=2e-3, rtol=0)
    assert load_flow(whole).objects.draw(whole.model, 1, torch.Generator()).what.any()


def test_what_is_missing_is_looked_for_and_no_more(data: Path, found: Path, tmp_path: Path):
    of = copied(tmp_path / "model", found)
    lost = of.folder / PARTIAL / "clip-00002.safetensors"
    before = lost.read_bytes()
    lost.unlink()
    said: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        learned(of, data, say=lambda line: (said.append(line), stop_at("Learning from")(line))[0])
    assert "Looking for objects in 1 clip of" in said[0]
    assert len(lost.read_bytes()) == len(before)


def test_another_seed_is_another_flow(data: Path, found: Path, tmp_path: Path):
    one, other = (load_file(learned(copied(tmp_path / str(seed), found), data, steps=2, seed=seed)) for seed in (0, 1))
    assert not torch.equal(one["leave.weight"], other["leave.weight"])
    assert torch.equal(one["code"], other["code"])


def test_learning_makes_the_loss_smaller(data: Path, found: Path, tmp_path: Path):
    said: list[str] = []
    learned(copied(tmp_path / "model", found), data, steps=40, say=said.append)
    losses = [float(line.split("loss ")[1].split(",")[0]) for line in said if line.startswith("step")]
    assert len(losses) == 20
    assert sum(losses[-5:]) < sum(losses[:5])


def test_what_was_begun_otherwise_or_is_damaged_is_refused(data: Path, found: Path, tmp_path: Path):
    of = copied(tmp_path / "model", found)
    with pytest.raises(KeyboardInterrupt):
        learned(of, data, say=stop_at("step 2"))
    with pytest.raises(UsageError, match="there and here differ: steps 6 and 7"):
        learned(of, data, steps=7)
    (of.folder / PARTIAL / "state.safetensors").write_bytes(b"other")
    with pytest.raises(CorruptFile, match=r"state\.safetensors is damaged .*; delete it"):
        learned(of, data)
    clip = of.folder / PARTIAL / "clip-00001.safetensors"
    tensors = {name: value.clone() for name, value in load_file(clip).items()}
    clip.write_bytes(b"other")
    with pytest.raises(CorruptFile, match=r"clip-00001\.safetensors is damaged .*; delete it"):
        learned(of, data)
    for change, message in (
        ({"values": tensors["values"].double()}, "values is float64"),
        ({"half": tensors["half"][1:].clone()}, "values is float32 of shape"),
        ({"half": -tensors["half"]}, "half has values below 0"),
        ({"half": torch.tensor(1.0)}, "values is float32 of shape"),
        ({"what": tensors["what"][:, 1:].clone()}, "what is float32 of shape"),
        ({"what": None}, "what is missing"),
        ({"more": torch.zeros(1)}, "more is unknown"),
        ({"values": tensors["values"] * torch.nan}, "values holds NaN"),
    ):
        changed = {name: value for name, value in {**tensors, **change}.items() if value is not None}
        save_file(changed, clip)
        with pytest.raises(CorruptFile, match=rf"clip-00001\.safetensors is damaged .*{message}.*; delete it"):
            learned(of, data)
    for name in ("learning.json", "looking.json"):
        for text in ("[", "[]", "3", "{}", '{"clips": NaN}', "[" * 100_000):
            (of.folder / PARTIAL / name).write_text(text)
            with pytest.raises(CorruptFile, match=rf"{name} is damaged; delete .*flow\.partial to begin anew"):
                learned(of, data)


def test_a_state_that_is_not_the_flow_s_is_damaged(data: Path, found: Path, tmp_path: Path):
    of = copied(tmp_path / "model", found)
    with pytest.raises(KeyboardInterrupt):
        learned(of, data, say=stop_at("step 4"))
    path = of.folder / PARTIAL / "state.safetensors"
    tensors = {name: value.clone() for name, value in load_file(path).items()}
    for change, step, message in (
        ({"flow.code": None}, "4", "code is missing"),
        ({"flow.code": torch.zeros(31)}, "4", "code is float32 of shape"),
        ({"elsewhere.code": torch.zeros(1)}, "4", "elsewhere"),
        ({"optimiser.leave.bias.step": None}, "4", "leave.bias.step is missing"),
        ({name: None for name in tensors if name.startswith("optimiser.")}, "4", "it is of step 4 of 6"),
        ({}, "7", "it is of step 7 of 6"),
        ({}, "x", "invalid literal"),
    ):
        changed = {name: value for name, value in {**tensors, **change}.items() if value is not None}
        save_file(changed, path, metadata={"step": step})
        with pytest.raises(CorruptFile, match=rf"state\.safetensors is damaged .*{message}.*; delete it"):
            learned(of, data)


def test_how_near_the_nearest_of_others_is():
    others = torch.randn(6, VALUES)
    assert nearest(others[:3], others) == pytest.approx(0, abs=1e-3)
    assert nearest(others[:3] + 1, others[:3]) == pytest.approx(1, abs=1e-3)


def test_more_clips_can_be_asked_for_as_long_as_nothing_is_learned(data: Path, found: Path, tmp_path: Path):
    of = copied(tmp_path / "model", found)
    message = r"Examples of objects found: .* in 3 clips; expected 1000\. Give more --clips"
    with pytest.raises(UsageError, match=message):
        learned(of, data, clips=3, least_objects=1000)
    with pytest.raises(KeyboardInterrupt):
        learned(of, data, say=stop_at("step 2"))


def test_a_loss_that_is_no_number_ends_it(data: Path, found: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    of = copied(tmp_path / "model", found)
    monkeypatch.setattr(train_flow, "flow_loss", lambda *_: torch.tensor(torch.nan, requires_grad=True))
    with pytest.raises(Diverged, match="The loss of step 1 is nan; delete"):
        learned(of, data)
    assert not (of.folder / "flow.safetensors").exists()
