import json
from pathlib import Path

import numpy as np
import pytest

from datagen.errors import UsageError
from datagen.inspect import stats
from datagen.scene import Scene, Trajectory
from datagen.storage.reader import Dataset
from datagen.storage.shard import pack
from datagen.storage.spec import read_spec
from tests.worlds import rendered
from tests.worlds.imported import import_balls


def test_figures_are_those_of_a_known_scene(tmp_path: Path):
    record = rendered.record(rendered.scene(frames=3))
    figures = stats.summary(rendered.write_dataset(tmp_path / "staged", [record]))
    assert figures["scenes"] == {"train": 1, "val": 0, "test": 0}
    assert (figures["images"], figures["frames_per_scene"], figures["views"]) == (3, 3, 1)
    assert figures["objects_per_scene"] == {"3": 1}
    assert figures["categories"] == {"box": 1, "cylinder": 1, "sphere": 1}
    assert figures["motions"] == {"slide": 3}
    assert figures["moving_objects"] == 1.0
    assert figures["colliding_clips"] == figures["touching_frames"] == 0.0
    assert figures["attempts_per_scene"] == 1.0
    assert figures["rejected"] == {}
    assert figures["foreground"]["train"] == pytest.approx(np.mean(record["segmentation"] > 0))
    assert figures["depth_range"] == pytest.approx([1e-4 * record["depth"][0].min(), 1e-4 * record["depth"][0].max()])
    assert figures["visible_fraction_quantiles"]["0.95"] == 1.0
    json.dumps(figures)


def test_contacts_collisions_and_rest_are_told_apart(tmp_path: Path):
    def colliding(world: Scene) -> Trajectory:
        path = rendered.trajectory(world)
        path.position[:] = path.position[:1]
        path.contact_gap[:, 1, 2] = path.contact_gap[:, 2, 1] = [0.01, 0.001, 0.001]
        path.contact_impulse[2, 1, 2] = path.contact_impulse[2, 2, 1] = 0.1
        return path

    record = rendered.record(rendered.scene(frames=3), motion=colliding)
    record["scene/attempts"] = np.asarray(4, np.uint16)
    record["scene/rejections"] = np.asarray(b'{"left": 2, "overlap": 1}')
    still = rendered.record(rendered.scene(frames=3))
    still["scene/rejections"] = np.asarray(b'{"left": 1}')
    figures = stats.summary(rendered.write_dataset(tmp_path / "staged", [record, still]))
    assert figures["colliding_clips"] == 0.5
    assert figures["touching_frames"] == pytest.approx(2 / 6)
    assert figures["moving_objects"] == 0.5
    assert figures["attempts_per_scene"] == 2.5
    assert figures["rejected"] == {"left": 3 / 5, "overlap": 1 / 5}


def test_stats_and_facts_are_printed(tiny_dataset: Path, capsys: pytest.CaptureFixture[str]):
    stats.run(tiny_dataset)
    printed = capsys.readouterr().out
    assert "moving" in printed
    assert "foreground" in printed
    stats.inspect(tiny_dataset, "val", 1)
    printed = capsys.readouterr().out
    assert Dataset(tiny_dataset).split("val").hash(1) in printed
    for category in Dataset(tiny_dataset).split("val")[1]["objects/category"]:
        assert category.decode() in printed


def test_stats_and_card_of_an_import_leave_out_what_it_does_not_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    folder = import_balls(tmp_path).folder
    stats.run(folder)
    printed = capsys.readouterr().out
    assert "48x36" in printed
    assert "KiB" in printed
    card = (folder / "README.md").read_text()
    assert "| resolution | 48x36 |" in card
    for text in (printed, card):
        assert "seed" not in text
        assert "renderer" not in text


def test_scenes_that_are_not_there_are_the_user_s_error(tiny_dataset: Path):
    with pytest.raises(UsageError, match="scenes 0 to 1"):
        stats.inspect(tiny_dataset, "val", 2)
    with pytest.raises(UsageError, match="Unknown split"):
        stats.inspect(tiny_dataset, "validation", 0)


def test_names_with_brackets_and_colours_that_are_none_are_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    record = rendered.record(rendered.scene(frames=2))
    record["objects/category"] = np.array([b"[/box]", b"[red]", b"", b""])
    record["objects/color"][0, 0] = [np.nan, np.inf, -1]
    folder = rendered.write_dataset(tmp_path / "[/staged]", [record])
    stats.inspect(folder, "train", 0)
    stats.run(folder)
    printed = capsys.readouterr().out
    assert {"[/box]", "[red]", "#00ff00"} <= set(printed.split())
    assert "[/staged]" in printed


def test_only_shards_of_the_dataset_are_measured(tmp_path: Path):
    folder = rendered.write_dataset(tmp_path / "staged", [rendered.record(rendered.scene(frames=2))])
    before = stats.summary(folder)
    (folder / "other.h5").write_bytes(bytes(10_000))
    assert stats.summary(folder) == before


def test_a_scene_without_a_field_of_the_table_is_one_clear_error(tmp_path: Path):
    record = rendered.record(rendered.scene(frames=2))
    folder = rendered.write_dataset(tmp_path / "staged", [record])
    del record["objects/mass"]
    rendered.write_shard(folder, read_spec(folder), "train", 0, [pack(record)])
    with pytest.raises(UsageError, match="no field 'objects/mass'"):
        stats.inspect(folder, "train", 0)
