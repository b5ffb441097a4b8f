from pathlib import Path

import pytest

import assets
from obpose.errors import UsageError
from obpose.storage.pretrained import content_hash, find_shipped, list_shipped, shipped_names, shipped_to_create


@pytest.fixture
def checkpoints(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(assets, "CHECKPOINTS", tmp_path / "checkpoints")
    return tmp_path / "checkpoints"


def ship(checkpoints: Path, name: str) -> Path:
    folder = checkpoints / name
    folder.mkdir(parents=True)
    (folder / "model.safetensors").write_bytes(b"weights")
    (folder / "config.json").write_text("{}")
    return folder


def test_weights_are_found_by_model_track_and_resolution(checkpoints: Path):
    wide = ship(checkpoints, "obpose--clevr3d--80x60")
    ship(checkpoints, "obpose-loc--clevr3d--80x60")
    assert find_shipped("obpose", "clevr3d", (80, 60)) == wide
    for wanted in (
        ("obpose", "clevr3d", (64, 64)),
        ("obpose", "moving", (80, 60)),
        ("obpose-none", "clevr3d", (80, 60)),
    ):
        with pytest.raises(UsageError, match="There are: obpose--clevr3d--80x60, obpose-loc--clevr3d--80x60"):
            find_shipped(*wanted)


def test_pictures_are_made_with_the_weights_for_them_where_there_are_any(checkpoints: Path):
    for name in ("obpose--clevr3d--80x60", "obpose--moving--64x64", "obpose-contact--moving--64x64"):
        ship(checkpoints, name)
    assert shipped_to_create("moving") == "obpose-contact--moving--64x64"
    assert shipped_to_create("clevr3d") == "obpose--clevr3d--80x60"
    with pytest.raises(UsageError, match="No weights of obpose for static ship with this package"):
        shipped_to_create("static")


def test_there_may_be_none(checkpoints: Path):
    assert (shipped_names(), list_shipped()) == ([], "There are none at all.")
    with pytest.raises(UsageError, match="There are none at all"):
        find_shipped("obpose", "moving", (64, 64))


def test_the_hash_is_of_weights_and_configuration_and_of_nothing_else(checkpoints: Path):
    folder = ship(checkpoints, "a--b--1x1")
    before = content_hash(folder)
    (folder / "README.md").write_text("how it was made")
    assert content_hash(folder) == before == content_hash(ship(checkpoints, "c--d--1x1"))
    (folder / "config.json").write_text("{ }")
    assert content_hash(folder) != before


@pytest.mark.parametrize("name", shipped_names())
def test_what_ships_can_be_loaded(name: str):
    from obpose.storage.checkpoint import load

    model, _, _ = load(assets.CHECKPOINTS / name)
    assert all(weights.isfinite().all() for weights in model.state_dict().values())
