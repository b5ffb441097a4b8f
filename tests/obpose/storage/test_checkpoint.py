import json
import math
import re
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from obpose.baselines.obsurf.model import Obsurf
from obpose.errors import CorruptFile, UsageError
from obpose.storage.checkpoint import (
    CONFIG,
    DIGEST,
    MODEL,
    TABLES,
    TRAINING,
    TrainingState,
    load,
    load_obpose,
    load_training,
    save_model,
    save_training,
    signed_model,
)
from obpose.systems import build_model, find_system
from tests.obpose.toy import ToyModel, toy_config

SAME = {
    "model.table": None,
    "model.backbone.blocks": (0, 1, 1, 0),
    "train.learning_rate": 0.1,
}
CONFIGURATION = toy_config(**SAME)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    model = ToyModel(CONFIGURATION)
    optimizer = {"mean.step": torch.tensor(3.0), "layers.0.weight.exp_avg": torch.rand(8, 1)}
    save_training(tmp_path, TrainingState(model.state_dict(), optimizer, {"step": 3}))
    save_model(tmp_path, model.state_dict(), CONFIGURATION, {"step": 3})
    return tmp_path


def test_a_model_comes_back_as_it_was(tmp_path: Path):
    model = ToyModel(CONFIGURATION)
    save_model(tmp_path, model.state_dict(), CONFIGURATION, {"seconds": 0.1 + 0.2, "curve": []})
    twin, config, info = load(tmp_path, ToyModel)
    assert config == CONFIGURATION
    assert info == {"seconds": 0.1 + 0.2, "curve": []}
    assert not twin.training
    for name, value in model.state_dict().items():
        assert torch.equal(twin.state_dict()[name], value)


def test_loading_leaves_the_global_generator_alone(run: Path):
    torch.manual_seed(3)
    expected = torch.rand(2)
    torch.manual_seed(3)
    load(run, ToyModel)
    assert torch.equal(torch.rand(2), expected)


def test_a_training_comes_back_as_it_was(run: Path):
    state = load_training(run, CONFIGURATION)
    assert state is not None
    assert state.optimizer.keys() == {"mean.step", "layers.0.weight.exp_avg"}
    assert state.optimizer["mean.step"] == 3
    weights = load(run, ToyModel)[0].state_dict()
    assert state.weights.keys() == weights.keys()
    assert all(torch.equal(value, weights[name]) for name, value in state.weights.items())
    assert state.info == {"step": 3}


def test_where_nothing_was_begun_there_is_no_training(tmp_path: Path):
    assert load_training(tmp_path, CONFIGURATION) is None


def test_another_configuration_is_refused_with_what_differs(run: Path):
    with pytest.raises(UsageError, match=r"differ: train.batch: 1, 7; train.seed: 0, 1\."):
        load_training(run, toy_config(**{**SAME, "train.batch": 7, "train.seed": 1}))


def test_tensors_may_share_memory(tmp_path: Path):
    shared = torch.rand(4)
    save_model(tmp_path, {"mean": shared[:3], "again": shared}, CONFIGURATION, {})
    found = load_file(tmp_path / MODEL)
    assert torch.equal(found["mean"], shared[:3])
    assert torch.equal(found["again"], shared)


def test_a_folder_without_a_model_is_refused(tmp_path: Path):
    with pytest.raises(UsageError, match="holds no model"):
        load(tmp_path, ToyModel)


def test_weights_of_another_architecture_are_refused(run: Path):
    class Other(ToyModel):
        def __init__(self, config):
            super().__init__(config)
            self.more = torch.nn.Linear(1, 1)

    with pytest.raises(UsageError, match=r"do not fit.*more"):
        load(run, Other)


def test_another_version_is_refused(run: Path):
    facts = json.loads((run / CONFIG).read_text())
    for version in (99, True, 1.0, "1", None):
        (run / CONFIG).write_text(json.dumps({**facts, "version": version}))
        with pytest.raises(UsageError, match=f"version {version!r}, expected 1"):
            load(run, ToyModel)


@pytest.mark.parametrize("name", [CONFIG, MODEL, TRAINING])
def test_a_file_cut_short_is_reported(run: Path, name: str):
    whole = (run / name).read_bytes()
    (run / name).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CorruptFile, match=f"{name} is damaged"):
        load_training(run, CONFIGURATION) if name == TRAINING else load(run, ToyModel)


def test_other_bytes_of_the_weights_are_damage(run: Path):
    whole = bytearray((run / MODEL).read_bytes())
    whole[-2] ^= 1  # still a finite weight
    (run / MODEL).write_bytes(whole)
    with pytest.raises(CorruptFile, match=r"model\.safetensors is damaged \(its SHA-256"):
        load(run, ToyModel)
    (run / DIGEST).unlink()  # as in folders that have none
    load(run, ToyModel)


def test_weights_that_are_written_have_no_digest_of_others(run: Path):
    with pytest.raises(KeyboardInterrupt), signed_model(run):
        raise KeyboardInterrupt
    assert not (run / DIGEST).exists()
    load(run, ToyModel)


@pytest.mark.parametrize("lost", [(CONFIG,), (CONFIG, TRAINING), (CONFIG, MODEL)])
def test_where_a_configuration_is_lost_the_weights_are_not_overwritten(run: Path, lost: tuple[str, ...]):
    for name in lost:
        (run / name).unlink()
    with pytest.raises(UsageError, match=r"but no config\.json; it would be overwritten"):
        load_training(run, CONFIGURATION)


def test_a_kill_in_the_first_save_does_no_harm(tmp_path: Path):
    save_training(tmp_path, TrainingState(ToyModel(CONFIGURATION).state_dict(), {}, {"step": 0}))
    assert load_training(tmp_path, CONFIGURATION) is None


def test_a_model_in_the_place_of_a_training_is_told(run: Path):
    (run / TRAINING).write_bytes((run / MODEL).read_bytes())
    with pytest.raises(CorruptFile, match=r"training\.safetensors is no training"):
        load_training(run, CONFIGURATION)


def test_a_configuration_of_another_kind_is_damaged(run: Path):
    for facts in ({"version": 1, "config": 3}, {"version": 1}, {"config": {}}, [], 3, None):
        (run / CONFIG).write_text(json.dumps(facts))
        with pytest.raises(CorruptFile, match="is damaged"):
            load(run, ToyModel)


def test_an_empty_configuration_is_no_configuration(run: Path):
    facts = json.loads((run / CONFIG).read_text())
    for config in ({}, {"model": {}, "loss": {}, "train": {}}):
        (run / CONFIG).write_text(json.dumps({**facts, "config": config}))
        with pytest.raises(UsageError, match=r"config\.json: The configuration lacks model\.slots and 62 other values"):
            load(run, ToyModel)


def test_values_that_nobody_wrote_beside_the_configuration_are_damage(run: Path):
    facts = json.loads((run / CONFIG).read_text())
    (run / CONFIG).write_text(json.dumps({**facts, "more": 1}))
    with pytest.raises(CorruptFile, match="expected architecture, config, version and nothing else"):
        load(run, ToyModel)


def test_sizes_that_no_machine_could_hold_are_refused_before_a_model_is_built(run: Path):
    def build(config: object) -> ToyModel:
        raise AssertionError("it was built")

    facts = json.loads((run / CONFIG).read_text())
    for part, name, value in (("model", "slots", 10**9), ("model", "voxels", 10**6)):
        changed = {**facts["config"], part: {**facts["config"][part], name: value}}
        (run / CONFIG).write_text(json.dumps({**facts, "config": changed}))
        with pytest.raises(UsageError, match=f"config.json: {part}.{name} is {value}; expected at most"):
            load(run, build)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mean": None}, "mean is missing"),
        ({"more": torch.zeros(1)}, "more is unknown"),
        ({"mean": None, "meen": torch.zeros(3)}, "mean is missing, meen is unknown"),
        ({"mean": torch.zeros(3, dtype=torch.float64)}, "mean is float64 of shape [3], expected float32 of shape [3]"),
        ({"mean": torch.zeros(3, dtype=torch.bfloat16)}, "mean is bfloat16"),
        ({"mean": torch.zeros(3, dtype=torch.int32)}, "mean is int32"),
        ({"mean": torch.zeros(1, 3)}, "mean is float32 of shape [1, 3]"),
        ({"mean": torch.zeros(())}, "mean is float32 of shape []"),
    ],
)
def test_weights_of_other_names_types_or_shapes_are_refused(
    run: Path, change: dict[str, torch.Tensor | None], message: str
):
    weights = {**ToyModel(CONFIGURATION).state_dict(), **change}
    weights = {name: tensor for name, tensor in weights.items() if tensor is not None}
    save_model(run, weights, CONFIGURATION, {})
    with pytest.raises(
        UsageError, match=rf"weights in .* do not fit the model of its configuration: {re.escape(message)}"
    ):
        load(run, ToyModel)


@pytest.mark.parametrize("info", ["[]", "3", '{"step": NaN}', "{", "[" * 100_000])
def test_facts_that_are_none_are_damage(run: Path, info: str):
    weights = ToyModel(CONFIGURATION).state_dict()
    save_file(weights, run / MODEL, metadata={"info": info})
    with pytest.raises(CorruptFile, match=r"model\.safetensors is damaged"):
        load(run, ToyModel)


def test_the_configuration_says_of_which_architecture_it_is(tmp_path: Path):
    config = find_system("obsurf").config("cpu", {"model.encoder.width": 8})
    model = build_model(config)
    save_model(tmp_path, model.state_dict(), config, {})
    found, again, _ = load(tmp_path)
    assert again == config
    assert isinstance(found, Obsurf)
    with pytest.raises(UsageError, match="holds a model of class Obsurf; expected one of ObPose's variants"):
        load_obpose(tmp_path)
    with pytest.raises(UsageError, match="the kind of model: ObsurfConfig, Config"):
        load_training(tmp_path, CONFIGURATION)


def test_files_older_than_the_second_architecture_are_of_the_first(run: Path):
    facts = json.loads((run / CONFIG).read_text())
    assert facts.pop("architecture") == "obpose"
    (run / CONFIG).write_text(json.dumps(facts))
    assert load(run, ToyModel)[1] == CONFIGURATION
    for name in ("elsewhere", []):
        (run / CONFIG).write_text(json.dumps({**facts, "architecture": name}))
        with pytest.raises(UsageError, match=r"architecture .*; this version has obpose, obsurf, supervised, contact"):
            load(run, ToyModel)


def test_a_training_that_counted_steps_may_have_had_no_end_in_time(tmp_path: Path):
    config = toy_config(**SAME, **{"train.minutes": math.inf})
    save_model(tmp_path, ToyModel(config).state_dict(), config, {})
    assert load(tmp_path, ToyModel)[1] == config


@pytest.mark.parametrize(
    ("name", "advice"),
    [(MODEL, "the obpose-train command that began it writes it anew"), (TRAINING, "begin anew in another folder")],
)
def test_a_missing_file_is_reported_with_what_keeps_the_intact_one(run: Path, name: str, advice: str):
    (run / name).unlink()
    with pytest.raises(CorruptFile, match=rf"{name} is missing, .*{advice}"):
        load_training(run, CONFIGURATION) if name == TRAINING else load(run, ToyModel)


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_somebody_else_are_not_overwritten(tmp_path: Path, name: str):
    (tmp_path / name).write_text("step\n")
    assert load_training(tmp_path, CONFIGURATION) is None
    (tmp_path / name).write_text("step,accuracy\n1,0.9\n")
    with pytest.raises(UsageError, match=f"{name} has rows, but there is no config.json beside it"):
        load_training(tmp_path, CONFIGURATION)
