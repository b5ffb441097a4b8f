import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmark.metrics import clip_scores
from benchmark.results.run_folder import (
    COUNTS,
    LABELS,
    Measured,
    RunKey,
    RunRow,
    check_runs,
    delete_rows,
    load_runs,
    load_scenes,
    row_path,
    save_row,
    save_scenes,
    scene_line,
)
from datagen.errors import CorruptFile, UsageError

KEY = RunKey("moving", "moving", "model", 1, 2, "c" * 64, "f" * 64, "d" * 64)
ROW = RunRow(
    key=KEY,
    status="ok",
    reason="",
    config={"reach": 0.02},
    tuned=True,
    uses_labels=False,
    kind="learned",
    priors=("slots",),
    random=True,
    n_scenes=2,
    parameters=3,
    device="cpu",
    commit="abc",
    measured=Measured(0.1, 2.0, 300.0),
    learning_curve=[{"step": 1.0, "loss": 0.3}],
)


def lines(scenes: int = 2, frames: int = 3) -> list[dict[str, float | int]]:
    rng = np.random.default_rng(0)
    maps = rng.integers(0, 3, (scenes, 2, frames, 1, 6, 5))
    return [scene_line(index, clip_scores(*pair)) for index, pair in enumerate(maps)]


def test_a_row_is_read_as_it_was_written(tmp_path: Path):
    save_row(tmp_path, ROW)
    assert load_runs(tmp_path) == [ROW]
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [f"{KEY.name}.json"]


def test_a_learning_curve_is_a_file_of_its_own(tmp_path: Path):
    save_row(tmp_path, ROW)
    assert (tmp_path / "curves" / f"{KEY.name}.csv").read_text() == "step,loss\n1.0,0.3\n"
    assert "learning_curve" not in json.loads(row_path(tmp_path, KEY).read_text())


def test_costs_that_were_not_measured_are_null_in_the_file(tmp_path: Path):
    """JSON has no nan, so that other readers could not read it."""
    save_row(tmp_path, dataclasses.replace(ROW, status="failed", measured=Measured(math.nan, 2.0, math.inf)))

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    values = json.loads(row_path(tmp_path, KEY).read_text(), parse_constant=refuse)
    assert values["measured"] == {"seconds_per_frame": None, "fit_seconds": 2.0, "peak_mib": None}
    (row,) = load_runs(tmp_path)
    assert math.isnan(row.measured.seconds_per_frame)
    assert row.measured.fit_seconds == 2.0


def test_rows_with_nan_from_older_versions_are_read(tmp_path: Path):
    save_row(tmp_path, ROW)
    text = row_path(tmp_path, KEY).read_text().replace('"fit_seconds": 2.0', '"fit_seconds": NaN')
    row_path(tmp_path, KEY).write_text(text)
    assert math.isnan(load_runs(tmp_path)[0].measured.fit_seconds)


def test_rows_of_older_versions_are_read(tmp_path: Path):
    row = dataclasses.replace(ROW, learning_curve=None)
    save_row(tmp_path, row)
    values = json.loads(row_path(tmp_path, KEY).read_text())
    del values["pretrained"]
    row_path(tmp_path, KEY).write_text(json.dumps({**values, "learning_curve": None}))
    assert load_runs(tmp_path) == [row]


def test_rows_come_in_the_order_of_their_keys(tmp_path: Path):
    rows = [dataclasses.replace(ROW, key=dataclasses.replace(KEY, seed=seed)) for seed in (10, 2, 0)]
    for row in rows:
        save_row(tmp_path, row)
    assert [row.key.seed for row in load_runs(tmp_path)] == [0, 2, 10]


def test_no_rows_where_there_is_no_folder(tmp_path: Path):
    assert load_runs(tmp_path / "nowhere") == []
    with pytest.raises(UsageError, match="no finished runs"):
        check_runs(tmp_path)


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        (None, "status", "weird"),
        (None, "kind", "foo"),
        (None, "reason", 5),
        (None, "n_scenes", True),
        ("key", "seed", "2"),
        ("key", "track", None),
        ("measured", "fit_seconds", "x"),
        (None, "n_scenes", -1),
        (None, "config", []),
        (None, "priors", "slots"),
        (None, "priors", [1]),
        (None, "commit", None),
        (None, "trials", 0.5),
        ("key", "seed", -1),
    ],
)
def test_a_value_of_another_kind_is_damage(tmp_path: Path, part: str | None, name: str, value: object):
    save_row(tmp_path, ROW)
    path = row_path(tmp_path, KEY)
    values = json.loads(path.read_text())
    (values[part] if part else values)[name] = value
    path.write_text(json.dumps(values))
    with pytest.raises(CorruptFile, match=rf"json is damaged \(.*\$\..*{name}"):
        load_runs(tmp_path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"device": "cpu"', '"device": "\\ud800"'),
        ('"reach": 0.02', '"reach": Infinity'),
        ('"reach": 0.02', '"reach": 1e999'),
        ('"reach": 0.02', '"reach": ' + "[" * 200 + "]" * 200),
        ('"reach": 0.02', '"reach": ' + "[" * 100_000),
        ('"device": "cpu"', '"gadget": "cpu"'),
        ('"device": "cpu",', ""),
        ('"track": "moving"', '"track": "../../moving"'),
        ('"measured": {', '"measured": [], "x": {'),
    ],
)
def test_damage_in_a_row_is_named_in_one_line(tmp_path: Path, old: str, new: str):
    save_row(tmp_path, ROW)
    path = row_path(tmp_path, KEY)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(CorruptFile, match=f"{KEY.name}.json is damaged") as error:
        load_runs(tmp_path)
    assert len(str(error.value)) < 600
    assert "delete it and run the same command again" in str(error.value)


def test_what_foreign_models_say_of_themselves_can_be_read_again(tmp_path: Path):
    config = {"limit": math.inf, "deep": [{"x": math.nan}], "text": "\ud800", "count": 3}
    save_row(tmp_path, dataclasses.replace(ROW, config=config))
    (row,) = load_runs(tmp_path)
    assert row.config == {"limit": "inf", "deep": [{"x": "nan"}], "text": "?", "count": 3}


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("scene", 5.0, "not numbered 0, 1"),
        ("ari_fg", math.inf, "ari_fg holds inf, expected a score"),
        ("ari_fg", math.nan, "ari_fg holds nan, expected a score"),
        ("msc_fg", 9.5, "msc_fg holds 9.5, expected a score"),
        ("ari_fg_n", -1.0, "ari_fg_n holds -1.0, expected a count"),
        ("ari_fg_n", math.nan, "ari_fg_n holds nan, expected a count"),
        ("ari_fg_n", math.inf, "ari_fg_n holds inf, expected a count"),
        ("n_frames", math.nan, "n_frames holds nan"),
        ("identity_switches", -2.0, "identity_switches holds -2.0"),
    ],
)
def test_scores_that_are_none_are_damage(tmp_path: Path, column: str, value: float, message: str):
    first, second = lines()
    save_scenes(tmp_path, KEY.name, [first, {**second, column: value}])
    with pytest.raises(CorruptFile, match=message) as error:
        load_scenes(tmp_path, ROW)
    assert "restore it with: obpose-bench rescore" in str(error.value)


@pytest.mark.parametrize("name", ["ari_video_n", "ari_video", "scene", "msc_fg_video_n"])
def test_a_table_without_a_column_is_damage(tmp_path: Path, name: str):
    save_scenes(tmp_path, KEY.name, [{key: value for key, value in line.items() if key != name} for line in lines()])
    with pytest.raises(CorruptFile, match=r"no column|not numbered"):
        load_scenes(tmp_path, ROW)


def test_a_copy_of_a_row_is_not_another_seed(tmp_path: Path):
    save_row(tmp_path, ROW)
    path = row_path(tmp_path, KEY)
    path.with_name("copy.json").write_bytes(path.read_bytes())
    with pytest.raises(CorruptFile, match=r"copy\.json is damaged \(it holds the row moving--model--1"):
        load_runs(tmp_path)


def test_a_table_of_no_scenes_is_refused(tmp_path: Path):
    save_scenes(tmp_path, KEY.name, lines(scenes=1))
    path = tmp_path / "scenes" / f"{KEY.name}.csv"
    path.write_text(path.read_text().splitlines()[0] + "\n")
    with pytest.raises(CorruptFile, match="0 scenes"):
        load_scenes(tmp_path, dataclasses.replace(ROW, n_scenes=0))


def test_scenes_are_read_exactly_as_they_were_written(tmp_path: Path):
    written = lines()
    save_scenes(tmp_path, KEY.name, written)
    table = load_scenes(tmp_path, ROW)
    assert set(COUNTS) < set(table)
    for name, values in table.items():
        np.testing.assert_array_equal(values, [line[name] for line in written])


def test_a_table_with_scenes_missing_is_refused(tmp_path: Path):
    save_scenes(tmp_path, KEY.name, lines(scenes=1))
    with pytest.raises(CorruptFile, match="1 scene where the row has 2"):
        load_scenes(tmp_path, ROW)
    (tmp_path / "scenes" / f"{KEY.name}.csv").unlink()
    with pytest.raises(CorruptFile, match="rescore"):
        load_scenes(tmp_path, ROW)


def test_a_line_counts_the_values_behind_every_mean():
    truth = np.zeros((3, 1, 4, 4), np.int64)
    truth[0, 0, 0, :2] = [1, 2]
    truth[1, 0, 0, 0] = 1
    line = scene_line(5, clip_scores(truth, truth))
    assert line["scene"] == 5
    assert line["n_frames"] == 3
    assert (line["ari_n"], line["msc_fg_n"], line["ari_fg_video_n"]) == (3, 2, 1)
    assert (line["one_object"], line["undefined"], line["objects"]) == (1, 1, 1.0)
    assert line["msc_fg"] == 1.0


def test_an_image_has_no_video_scores_and_is_not_undefined_for_that():
    truth = np.array([[[[0, 1, 2]]]])
    line = scene_line(0, clip_scores(truth, truth))
    assert math.isnan(line["ari_video"])
    assert line["ari_video_n"] == line["undefined"] == 0


def test_deleted_rows_leave_nothing(tmp_path: Path):
    save_row(tmp_path, ROW)
    save_scenes(tmp_path, KEY.name, lines())
    (tmp_path / LABELS).mkdir()
    (tmp_path / LABELS / f"{KEY.name}.h5").write_bytes(b"")
    delete_rows(tmp_path, [ROW])
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []
