import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

import assets
from datagen.generate import generate
from obpose.creation import examples, learn
from obpose.creation.flow import Flow, mirrored
from obpose.creation.flow_prior import load_flow
from obpose.creation.grids import Grids
from obpose.creation.learn import PARTIAL, Lesson, learn_flow, nearest
from obpose.creation.origin import Origin, load_origin
from obpose.errors import CorruptFile, Diverged, UsageError
from tests import small

MODEL = "obpose--moving--64x64"
LESSON = Lesson(clips=4, steps=6, seed=0)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("learn") / "data"
    generate(folder, small.recipe(frames=3), splits={"train": 4}, resolution=(64, 64))
    return folder


@pytest.fixture(autouse=True)
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examples, "STEPS", 1)
    monkeypatch.setattr(learn, "BATCH", 4)
    monkeypatch.setattr(learn, "COMPARED", 8)
    monkeypatch.setattr(learn, "SAVE_STEPS", 2)
    monkeypatch.setattr(learn, "_LEAST_OBJECTS", 6)


def copied(folder: Path) -> Origin:
    shutil.copytree(assets.CHECKPOINTS / MODEL, folder)
    (folder / "flow.safetensors").unlink(missing_ok=True)
    return load_origin(str(folder))


def learned(origin: Origin, data: Path, lesson: Lesson = LESSON, *, say: Callable[[str], None] = print) -> Path:
    return learn_flow(origin, data, lesson, workers=1, say=say)


def stop_at(text: str) -> Callable[[str], None]:
    def say(line: str) -> None:
        if text in line:
            raise KeyboardInterrupt

    return say


def test_what_was_stopped_goes_on_to_the_same_end(data: Path, tmp_path: Path):
    whole, parts = copied(tmp_path / "whole"), copied(tmp_path / "parts")
    said: list[str] = []
    path = learned(whole, data, say=said.append)
    assert not (whole.folder / PARTIAL).exists()
    assert "Looking for objects in 4 clips" in said[0]
    for text in ("Learning from", "step 4 of 6"):
        with pytest.raises(KeyboardInterrupt):
            learned(parts, data, say=stop_at(text))
    (parts.folder / PARTIAL / "clip-00002.safetensors").unlink()
    said.clear()
    again = learned(parts, data, say=said.append)
    assert "Looking for objects in 1 clips" in said[0]
    assert [line.partition(":")[0] for line in said if line.startswith("step")] == ["step 6 of 6"]
    assert "median: samples" in said[-1]
    # The last digit of what is found may differ, as may that of what is learned from it.
    for name, value in load_file(path).items():
        torch.testing.assert_close(load_file(again)[name], value, atol=2e-3, rtol=0)
    assert load_flow(whole).flow.code.any()


def test_another_seed_is_another_flow(data: Path, tmp_path: Path):
    of = copied(tmp_path / "model")
    one = load_file(learned(of, data))
    other = load_file(learned(of, data, Lesson(clips=4, steps=6, seed=1)))
    assert not torch.equal(one["patch_out.weight"], other["patch_out.weight"])
    assert torch.equal(one["code"], other["code"])


def test_learning_makes_the_loss_smaller(data: Path, tmp_path: Path):
    said: list[str] = []
    learned(copied(tmp_path / "model"), data, Lesson(clips=4, steps=40, seed=0), say=said.append)
    losses = [float(line.split("loss ")[1].split(",")[0]) for line in said if line.startswith("step")]
    assert len(losses) == 20
    assert sum(losses[-5:]) < sum(losses[:5])


def test_what_was_begun_otherwise_or_is_damaged_is_refused(data: Path, tmp_path: Path):
    of = copied(tmp_path / "model")
    with pytest.raises(KeyboardInterrupt):
        learned(of, data, say=stop_at("step 2"))
    with pytest.raises(UsageError, match="there and here differ: steps 6 and 7"):
        learned(of, data, Lesson(clips=4, steps=7, seed=0))
    (of.folder / PARTIAL / "state.pt").write_bytes(b"other")
    with pytest.raises(CorruptFile, match=r"state\.pt is damaged .*; delete it"):
        learned(of, data)
    (of.folder / PARTIAL / "clip-00001.safetensors").write_bytes(b"other")
    with pytest.raises(CorruptFile, match=r"clip-00001\.safetensors is damaged; delete it"):
        learned(of, data)
    (of.folder / PARTIAL / "settings.json").write_text("[")
    with pytest.raises(CorruptFile, match=r"settings\.json is damaged; delete .*flow\.partial to begin anew"):
        learned(of, data)


def test_the_nearest_of_others_may_be_a_mirror_image():
    flow, grids = Flow(latent=2), Grids(torch.randn(6, 16, 16, 16, 4), torch.ones(6))
    three = Grids(grids.values[:3], grids.half[:3])
    assert nearest(flow, three, grids) == pytest.approx(0, abs=1e-3)
    assert nearest(flow, mirrored(three, torch.ones(3)), grids) == pytest.approx(0, abs=1e-3)
    off = Grids(three.values + torch.tensor([6.0, 1.2, 1.2, 1.2]), three.half)
    assert nearest(flow, off, three) == pytest.approx(1, abs=1e-3)


def test_a_loss_that_is_no_number_ends_it(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    of = copied(tmp_path / "model")
    monkeypatch.setattr(learn, "flow_loss", lambda *_: torch.tensor(torch.nan, requires_grad=True))
    with pytest.raises(Diverged, match="The loss of step 1 is nan; delete"):
        learned(of, data)
    assert not (of.folder / "flow.safetensors").exists()


def test_it_takes_some_objects(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(learn, "_LEAST_OBJECTS", 1000)
    with pytest.raises(UsageError, match="objects were found in 4 clips; give more of them"):
        learned(copied(tmp_path / "model"), data)
