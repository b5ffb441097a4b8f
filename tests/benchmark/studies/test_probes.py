from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmark.studies.__main__ import main
from benchmark.studies.probes import (
    Objects,
    Pair,
    Probe,
    height_beyond_shape,
    middle_frame,
    probe,
    probe_names,
    probe_numbers,
    true_properties,
)
from datagen.errors import EXIT_USAGE
from datagen.storage.reader import Dataset

RNG = np.random.default_rng(0)
INPUTS = RNG.normal(size=(300, 8))
SCENES = np.arange(300) // 4


def asked(method: Callable[[Pair, Pair, np.ndarray], Probe], values: np.ndarray) -> Probe:
    """Trained on the first 200 objects and tested on the others."""
    return method((INPUTS[:200], INPUTS[200:]), (values[:200], values[200:]), SCENES[200:])


def test_a_planted_number_is_found_and_noise_is_not():
    planted = INPUTS @ RNG.normal(size=8) + 3.0
    found = asked(probe_numbers, planted)
    assert found.score > 0.999
    assert found.low <= found.score <= found.high
    noise = RNG.normal(size=300)
    nothing = asked(probe_numbers, noise)
    assert abs(nothing.score) < 0.15
    assert -0.1 < nothing.baseline <= 0


def test_several_numbers_share_a_score():
    known = INPUTS[:, :1]
    both = np.column_stack([known, 10 * RNG.normal(size=(300, 1))])
    found = asked(probe_numbers, both)
    assert -0.2 < found.score < 0.15


def test_planted_names_are_found_and_the_baseline_is_the_most_frequent():
    names = np.where(INPUTS[:, 0] > 0.5, "ball", np.where(INPUTS[:, 1] > 0, "cube", "cone"))
    found = asked(probe_names, names)
    assert found.score > 0.85
    most = max(set(names[:200]), key=names[:200].tolist().count)
    assert found.baseline == np.mean(names[200:] == most)
    shuffled = RNG.permutation(names)
    assert asked(probe_names, shuffled).score < 0.6


def objects(seed: int, count: int = 120) -> Objects:
    """Latents that hold shape, colour and size, and not the position."""
    rng = np.random.default_rng(seed)
    shape, colour, size = rng.integers(0, 3, count), rng.integers(0, 2, (count, 3)), rng.uniform(0.05, 0.1, count)
    position = rng.uniform(-0.3, 0.3, (count, 3))
    return Objects(
        scene=np.arange(count) // 3,
        what=np.column_stack([np.eye(3)[shape], colour, size, rng.normal(size=(count, 4))]),
        place=position + 0.001 * rng.normal(size=position.shape),
        shape=np.array(["ball", "cube", "cone"])[shape],
        colour=colour.astype(float),
        plain=rng.random(count) < 0.7,
        size=size,
        position=position,
        missed=0,
    )


def test_the_table_shows_what_latents_hold():
    found = {str(line["what"]): line for line in probe(objects(0), objects(1))}
    positions = [*(f"position, {axis}" for axis in "xyz"), "position, z, beyond shape and size"]
    assert list(found) == ["shape", "colour, of a palette", "colour", "size", *positions]
    for name in ("shape", "colour", "size"):
        assert found[name]["z_what"] > 0.99
        assert found[name]["t_hat"] < 0.6
    for axis in "xyz":
        assert found[f"position, {axis}"]["z_what"] < 0.1
        assert found[f"position, {axis}"]["t_hat"] > 0.99
    assert found["colour"]["learned_from"] < found["size"]["learned_from"] == 120


def test_height_beyond_shape_and_size_is_how_high_objects_float():
    standing, others = objects(0), objects(1)
    heights = {"ball": 0.5, "cube": 0.4, "cone": 0.25}
    for each in (standing, others):
        each.position[:, 2] = [heights[name] * size for name, size in zip(each.shape, each.size, strict=True)]
    np.testing.assert_allclose(height_beyond_shape(standing)(others), 0, atol=1e-9)
    assert "position, z, beyond shape and size" not in {line["what"] for line in probe(standing, others)}
    floating = np.where(np.arange(120) % 2, 0.2, 0.0)
    others.position[:, 2] += floating
    np.testing.assert_allclose(height_beyond_shape(standing)(others), floating, atol=1e-9)
    others.what[:, -1] = floating
    held = {line["what"]: line["z_what"] for line in probe(others, others)}
    assert held["position, z, beyond shape and size"] > 0.95


def test_an_object_is_read_in_the_middle_of_its_matched_frames():
    assert middle_frame(np.array([-1, 1, 1, 0, -1])) == 2
    assert middle_frame(np.array([-1, -1, -1, 0, -1])) == 3


def test_true_properties_are_the_generators(clips: Path):
    record = Dataset(clips).split("test")[0]
    known = true_properties(record, 0, 1)
    assert known["position"] == pytest.approx(record["boxes/box_3d"][1, 0].mean(axis=0), abs=1e-4)
    assert known["shape"] == record["objects/category"][0].decode()
    assert 0.01 < known["size"] < 0.3


def test_the_command_refuses_too_few_objects(clips: Path, checkpoint: Path, capsys: pytest.CaptureFixture[str]):
    flags = ["--data", str(clips), "--checkpoint", str(checkpoint), "--scenes", "1", "--learn-scenes", "1"]
    assert main(["probes", *flags]) == EXIT_USAGE
    assert "objects of train were found; expected 20" in capsys.readouterr().err
