from pathlib import Path

import pytest

import assets
from obpose.errors import UsageError
from obpose.storage.pretrained import content_hash, find_shipped, list_shipped, shipped_names, shipped_to_create


def ship(checkpoints: Path, name: str) -> Path:
    folder = checkpoints / name
    folder.mkdir()
    (folder / "model.safetensors").write_bytes(b"weights")
    (folder / "config.json").write_text("{}")
    return folder


def test_weights_are_found_by_model_track_and_resolution():
    assert find_shipped("obpose", "clevr3d", (80, 60)) == assets.CHECKPOINTS / "obpose--clevr3d--80x60"
    for wanted in (
        ("obpose", "clevr3d", (64, 64)),
        ("obpose", "moving", (80, 60)),
        ("obpose-none", "clevr3d", (80, 60)),
    ):
        with pytest.raises(UsageError, match=r"There are: .*obpose--clevr3d--80x60, .*obpose--moving--64x64, "):
            find_shipped(*wanted)


def test_pictures_are_made_with_the_weights_for_them_where_there_are_any(tmp_path: Path):
    for name in ("obpose--clevr3d--80x60", "obpose--moving--64x64", "obpose-contact--moving--64x64"):
        ship(tmp_path, name)
    assert shipped_to_create("moving", tmp_path) == "obpose-contact--moving--64x64"
    assert shipped_to_create("clevr3d", tmp_path) == "obpose--clevr3d--80x60"
    with pytest.raises(UsageError, match=r"No weights of obpose-contact or obpose for static ship.* are: obpose--c"):
        shipped_to_create("static", tmp_path)


def test_there_may_be_none(tmp_path: Path):
    assert (shipped_names(tmp_path), list_shipped(tmp_path)) == ([], "There are none at all.")


def test_the_hash_is_of_weights_and_configuration_and_of_nothing_else(tmp_path: Path):
    folder = ship(tmp_path, "a--b--1x1")
    before = content_hash(folder)
    (folder / "README.md").write_text("how it was made")
    assert content_hash(folder) == before == content_hash(ship(tmp_path, "c--d--1x1"))
    (folder / "config.json").write_text("{ }")
    assert content_hash(folder) != before


@pytest.mark.parametrize("name", shipped_names())
def test_what_ships_can_be_loaded(name: str):
    from obpose.storage.checkpoint import load

    model, _, _ = load(assets.CHECKPOINTS / name)
    assert all(weights.isfinite().all() for weights in model.state_dict().values())
