"""Models and unfinished trainings on disk: safetensors and JSON, nothing pickled.

A folder holds `model.safetensors` and `config.json`, from which `load` builds the model, and `training.safetensors`:
everything that a training needs to go on, weights included, in one file, so that it is always of one step.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from obpose.config_text import differences, from_plain, to_plain
from obpose.errors import CorruptFile, UsageError
from obpose.files import write_whole
from obpose.model import ObPose
from obpose.systems import ARCHITECTURES, OBPOSE, architecture_of, build_model
from obpose.trainable import Configuration, Trainable

MODEL, CONFIG, TRAINING = "model.safetensors", "config.json", "training.safetensors"
TABLES = STEPS, VALIDATIONS = "training.csv", "validation.csv"
"""Curves of a training, beside its files."""
VERSION = 1
"""Of the files; raised when older ones can no longer be read."""

_MEND = {
    MODEL: f"where {TRAINING} beside it is intact, the obpose-train command that began it writes it anew; else give a "
    "copy of it, or train into another folder.",
    TRAINING: f"the training cannot go on, begin anew in another folder with --out. {MODEL} beside it is a file of its "
    "own and can be used still.",
}
"""What to do where one is damaged."""

Build = Callable[[Any], Trainable]
"""Makes a model with fresh weights."""

Info = dict[str, Any]
"""How a model came to be: steps, seconds and whatever else; what JSON can say."""

State = dict[str, Tensor]


@dataclass(frozen=True, eq=False)
class TrainingState:
    """A training between two steps."""

    weights: State
    optimizer: State
    """By `name of the parameter.name of the value`."""
    info: Info


def save_model(folder: Path, weights: State, config: Configuration, info: Info) -> None:
    """Write what `load` reads; the configuration last, so that where it is, all is."""
    _write_tensors(folder / MODEL, weights, info)
    facts = {"version": VERSION, "architecture": architecture_of(config).name, "config": to_plain(config)}
    write_whole(folder / CONFIG, (json.dumps(facts, indent=1) + "\n").encode())


def load(folder: Path, build: Build = build_model) -> tuple[Trainable, Configuration, Info]:
    """The model of a folder, on the CPU and in evaluation mode; `build` makes another than that of its configuration.

    Raises:
        UsageError: there is none, or it is of another version or architecture.
        CorruptFile: a file is damaged, or holds numbers that are none.
    """
    config = read_config(folder)
    weights, info = _read_tensors(folder / MODEL)
    if broken := [name for name, tensor in weights.items() if not tensor.isfinite().all()]:
        raise CorruptFile(f"{folder / MODEL} holds numbers that are not finite, in {broken[0]}; {_MEND[MODEL]}")
    with torch.random.fork_rng(devices=[]):
        model = build(config)
    put_weights(model, weights, str(folder))
    return model.eval(), config, info


def load_obpose(folder: Path) -> ObPose:
    """The same where poses and fields are asked for, which other architectures do not have.

    Raises:
        UsageError: as `load`, or the model is none of ObPose's.
        CorruptFile: a file is damaged.
    """
    model = load(folder)[0]
    if not isinstance(model, ObPose):
        raise UsageError(f"{folder} holds a model of class {type(model).__name__}; expected one of ObPose's variants.")
    return model


def read_config(folder: Path) -> Configuration:
    """The configuration of a folder's model.

    Raises:
        UsageError: there is none, it is of another version, or no model can be made of its values.
        CorruptFile: the file is damaged.
    """
    config = _stored_config(folder)
    # A training that counts steps may have no end in time, as the benchmark's have; for the model that is nothing.
    timeless: Any = replace(config, train=replace(config.train, minutes=1.0))  # pyright: ignore[reportArgumentType]
    try:
        architecture_of(config).check(timeless)
    except UsageError as error:
        raise UsageError(f"{folder / CONFIG}: {error}") from None
    return config


def put_weights(model: Trainable, weights: State, place: str) -> None:
    """Load weights into a model.

    Raises:
        UsageError: they are another architecture's.
    """
    try:
        model.load_state_dict(weights)
    except RuntimeError as error:
        raise UsageError(f"The weights in {place} do not fit the model of this version: {_line(error)}") from None


def save_training(folder: Path, state: TrainingState) -> None:
    """Write what `load_training` reads."""
    weights = {f"model.{name}": tensor for name, tensor in state.weights.items()}
    optimizer = {f"optimizer.{name}": tensor for name, tensor in state.optimizer.items()}
    _write_tensors(folder / TRAINING, weights | optimizer, state.info)


def load_training(folder: Path, config: Configuration) -> TrainingState | None:
    """The unfinished or finished training of a folder; None if nothing was begun there.

    Raises:
        UsageError: it is one of another configuration (says what differs), or the files there are somebody else's.
        CorruptFile: a file is damaged.
    """
    if not (folder / CONFIG).exists():
        _check_free(folder)
        return None
    if different := differences(_stored_config(folder), config):
        raise UsageError(
            f"{folder} holds a run of another configuration. There and here differ: {'; '.join(different)}. "
            "Give another --out, or the same values."
        )
    tensors, info = _read_tensors(folder / TRAINING)
    parts: dict[str, State] = {"model": {}, "optimizer": {}}
    for name, tensor in tensors.items():
        part, _, rest = name.partition(".")
        if part not in parts:
            raise CorruptFile(f"{folder / TRAINING} is no training, it holds {name!r}; {_MEND[TRAINING]}")
        parts[part][rest] = tensor
    return TrainingState(parts["model"], parts["optimizer"], info)


def _stored_config(folder: Path) -> Configuration:
    """As `read_config`, whatever the values are."""
    path = folder / CONFIG
    if not path.exists():
        raise UsageError(f"{folder} holds no model: there is no {CONFIG}. obpose-train makes one.")
    try:
        facts = json.loads(path.read_text())
        version, plain = facts["version"], facts["config"]
    except (ValueError, KeyError, TypeError):
        raise CorruptFile(f"{path} is damaged; train again into another folder.") from None
    if version != VERSION:
        raise UsageError(f"{path} is of version {version}, expected {VERSION}; train again, or use that version.")
    if not isinstance(plain, dict):
        raise CorruptFile(f"{path} is damaged; train again into another folder.")
    # Files that do not say it are older than the second architecture.
    name = facts.get("architecture", OBPOSE.name)
    if not isinstance(name, str) or name not in ARCHITECTURES:
        raise UsageError(f"{path} is of architecture {name!r}; this version has {', '.join(ARCHITECTURES)}.")
    try:
        return from_plain(plain, ARCHITECTURES[name].config)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def _check_free(folder: Path) -> None:
    """That no work is lost where a training begins; a kill during the very first save leaves files of step 0."""
    for name in (TRAINING, MODEL):
        if (folder / name).exists() and _read_tensors(folder / name)[1].get("step") != 0:
            raise UsageError(
                f"{folder} has a {name} but no {CONFIG}; it would be overwritten. Give another --out, or move it away."
            )
    for name in TABLES:
        if (folder / name).exists() and (folder / name).read_bytes().count(b"\n") > 1:
            raise UsageError(
                f"{folder / name} has rows, but there is no {CONFIG} beside it; it would be overwritten. Give another "
                "--out, or move it away."
            )


def _write_tensors(path: Path, tensors: State, info: Info) -> None:
    # Copies, because the format refuses tensors that share memory, as constants of several layers may.
    copies = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in tensors.items()
    }
    write_whole(path, save(copies, metadata={"info": json.dumps(info)}))


def _read_tensors(path: Path) -> tuple[State, Info]:
    if not path.exists():
        raise CorruptFile(f"{path} is missing, though there is a {CONFIG}; {_MEND[path.name]}")
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
            return tensors, json.loads((file.metadata() or {})["info"])
    except (SafetensorError, KeyError, ValueError) as error:
        raise CorruptFile(f"{path} is damaged ({error}); {_MEND[path.name]}") from None


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
