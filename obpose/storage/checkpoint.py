"""Storage of models and unfinished trainings, as safetensors and JSON.

A folder holds `model.safetensors` and `config.json`, from which `load` builds the model, and `model.sha256`, the digest
of the weights. `training.safetensors` has everything needed to resume training, weights included. It is a single file,
so that its contents are of one step.
"""

import hashlib
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save

from datagen.storage.atomic import write_atomically
from datagen.storage.safe_io import brief_reason, parse_json, read_bytes, read_json, read_text
from obpose.config_text import differences, from_plain, to_plain
from obpose.errors import CorruptFile, UsageError
from obpose.model.obpose import ObPose
from obpose.storage.pretrained import MOST_BYTES
from obpose.storage.tensors import Expect, Forms, State, differences_of, forms_of, read_tensors
from obpose.systems import ARCHITECTURES, OBPOSE, architecture_of, build_model
from obpose.trainable import Configuration, Trainable

MODEL, CONFIG, TRAINING = "model.safetensors", "config.json", "training.safetensors"
DIGEST = "model.sha256"
"""SHA-256 of the weights in the format of `sha256sum`. It is a file of its own, because the hashes of weights and
configuration identify results and scenes."""
TABLES = STEPS, VALIDATIONS = "training.csv", "validation.csv"
"""Tables with the curves of a training, in the same folder."""
VERSION = 1
"""Version of the file format; raised when older files can no longer be read."""

_MEND = {
    MODEL: f"where {TRAINING} beside it is intact, the obpose-train command that began it writes it anew; else give a "
    "copy of it, or train into another folder.",
    TRAINING: f"the training cannot go on, begin anew in another folder with --out. {MODEL} beside it is a file of its "
    "own and can be used still.",
}
"""Advice for the user when a file is damaged."""
_AGAIN = f"Give the {CONFIG} of the same run, or train again into another folder."

Build = Callable[[Any], Trainable]
"""Function that builds a model with fresh weights from a configuration."""

Info = dict[str, Any]
"""Facts about the training, such as steps and seconds, as JSON values."""

_MOST_CONFIG_BYTES = 2**20
_MOST_TABLE_BYTES = 2**30


@dataclass(frozen=True, eq=False)
class TrainingState:
    """A training between two steps."""

    weights: State
    optimizer: State
    """Optimiser state by key `parameter.value`."""
    info: Info
    extra: State = field(default_factory=dict)
    """Tensors by name that only training needs, besides weights and optimiser: those of `Trainable.training_state`."""


def save_model(folder: Path, weights: State, config: Configuration, info: Info) -> None:
    """Write a model for `load`. The configuration is written last: if it exists, the model is complete."""
    with signed_model(folder):
        _write_tensors(folder / MODEL, weights, info)
    facts = {"version": VERSION, "architecture": architecture_of(config).name, "config": to_plain(config)}
    write_atomically(folder / CONFIG, (json.dumps(facts, indent=1) + "\n").encode())


@contextmanager
def signed_model(folder: Path) -> Iterator[None]:
    """Write the digest of the weights that the block writes; if the process is killed, there is none."""
    with suppress(OSError):  # where a file cannot be deleted, writing reports it
        (folder / DIGEST).unlink()
    yield
    write_atomically(folder / DIGEST, f"{_digest(folder)}  {MODEL}\n".encode())


def _digest(folder: Path) -> str:
    return hashlib.sha256(read_bytes(folder / MODEL, MOST_BYTES)).hexdigest()


def _check_digest(folder: Path) -> None:
    found = _digest(folder)  # read first: a training may replace both files meanwhile
    try:
        expected = read_text(folder / DIGEST).split()[:1]
    except FileNotFoundError:  # as in folders of earlier versions
        return
    if expected != [found]:
        raise CorruptFile(
            f"{folder / MODEL} is damaged (its SHA-256 is not that of {DIGEST} beside it); {_MEND[MODEL]} If these "
            f"weights are right, delete {DIGEST}."
        )


def load(folder: Path, build: Build = build_model) -> tuple[Trainable, Configuration, Info]:
    """Load the model of a folder, on the CPU and in evaluation mode; `build` replaces the default constructor.

    Raises:
        UsageError: there is no model, its version or architecture is unknown, or its weights do not fit.
        CorruptFile: a file is damaged, holds NaN or infinity, or has another SHA-256 than `DIGEST` says.
    """
    config = read_config(folder)
    with torch.random.fork_rng(devices=[]):
        model = build(config)
    expected = forms_of(model.state_dict())
    weights, info = _read_tensors(folder / MODEL, lambda found: _check_fit(found, expected, str(folder)))
    _check_digest(folder)
    model.load_state_dict(weights)
    return model.eval(), config, info


def load_obpose(folder: Path) -> ObPose:
    """Load an ObPose model; other architectures have no poses and fields.

    Raises:
        UsageError: as in `load`, or the model is not a variant of ObPose.
        CorruptFile: a file is damaged.
    """
    model = load(folder)[0]
    if not isinstance(model, ObPose):
        raise UsageError(f"{folder} holds a model of class {type(model).__name__}; expected one of ObPose's variants.")
    return model


def read_config(folder: Path) -> Configuration:
    """Read and check the configuration of a folder's model.

    Raises:
        UsageError: there is none, its version is unknown, or its values are out of bounds.
        CorruptFile: the file is damaged.
    """
    config = _stored_config(folder)
    # A budget in steps may come with infinite minutes, as in the benchmark; the model does not depend on it.
    timeless: Any = replace(config, train=replace(config.train, minutes=1.0))  # pyright: ignore[reportArgumentType]
    try:
        architecture_of(config).check(timeless)
    except UsageError as error:
        raise UsageError(f"{folder / CONFIG}: {error}") from None
    return config


def put_weights(model: Trainable, weights: State, place: str) -> None:
    """Load weights into a model.

    Raises:
        UsageError: names, types or shapes differ from those of the model.
    """
    _check_fit(forms_of(weights), forms_of(model.state_dict()), place)
    model.load_state_dict(weights)


def _check_fit(found: Forms, expected: Forms, place: str) -> Forms:
    if wrong := differences_of(found, expected):
        raise UsageError(
            f"The weights in {place} do not fit the model of its configuration: {wrong}. Expected {CONFIG} and "
            f"{MODEL} of one run, made by this version."
        )
    return expected


def save_training(folder: Path, state: TrainingState) -> None:
    """Write the state of a training for `load_training`."""
    parts = {"model": state.weights, "optimizer": state.optimizer, "extra": state.extra}
    tensors = {f"{part}.{name}": tensor for part, values in parts.items() for name, tensor in values.items()}
    _write_tensors(folder / TRAINING, tensors, state.info)


def load_training(folder: Path, config: Configuration) -> TrainingState | None:
    """Load the unfinished or finished training of a folder; None if no training was started there.

    Raises:
        UsageError: its configuration differs (the message lists how), or the folder holds files of another run.
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
    parts: dict[str, State] = {"model": {}, "optimizer": {}, "extra": {}}
    for name, tensor in tensors.items():
        part, _, rest = name.partition(".")
        if part not in parts:
            raise CorruptFile(f"{folder / TRAINING} is no training, it holds {name!r}; {_MEND[TRAINING]}")
        parts[part][rest] = tensor
    return TrainingState(parts["model"], parts["optimizer"], info, parts["extra"])


def _stored_config(folder: Path) -> Configuration:
    """Read the configuration like `read_config`, without checking the bounds of its values."""
    path = folder / CONFIG
    if not path.exists():
        raise UsageError(f"{folder} holds no model: there is no {CONFIG}. obpose-train makes one.")
    # A budget in steps may come with infinite minutes.
    facts = read_json(path, most_bytes=_MOST_CONFIG_BYTES, infinite=True)
    known = {"version", "architecture", "config"}
    if not isinstance(facts, dict) or not {"version", "config"} <= facts.keys() <= known:
        raise CorruptFile(f"{path} is damaged; expected {', '.join(sorted(known))} and nothing else. {_AGAIN}")
    version, plain = facts["version"], facts["config"]
    if type(version) is not int or version != VERSION:
        raise UsageError(f"{path} is of version {version!r:.40}, expected {VERSION}; train again, or use that version.")
    if not isinstance(plain, dict):
        raise CorruptFile(f"{path} is damaged; expected a group of values as config. {_AGAIN}")
    # Files without an architecture are older than the second architecture.
    name = facts.get("architecture", OBPOSE.name)
    if not isinstance(name, str) or name not in ARCHITECTURES:
        raise UsageError(f"{path} is of architecture {name!r:.40}; this version has {', '.join(ARCHITECTURES)}.")
    try:
        return from_plain(plain, ARCHITECTURES[name].config)
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


def _check_free(folder: Path) -> None:
    """Check that a new training overwrites no earlier work.

    Files of step 0 are no work: a kill during the first save may leave them.
    """
    for name in (TRAINING, MODEL):
        if (folder / name).exists() and _read_tensors(folder / name)[1].get("step") != 0:
            raise UsageError(
                f"{folder} has a {name} but no {CONFIG}; it would be overwritten. Give another --out, or move it away."
            )
    for name in TABLES:
        if (folder / name).exists() and len(read_bytes(folder / name, _MOST_TABLE_BYTES).splitlines()) > 1:
            raise UsageError(
                f"{folder / name} has rows, but there is no {CONFIG} beside it; it would be overwritten. Give another "
                "--out, or move it away."
            )


def _write_tensors(path: Path, tensors: State, info: Info) -> None:
    # Copies, because the format refuses tensors that share memory, as constants of several layers may.
    copies = {
        name: tensor.detach().cpu().clone(memory_format=torch.contiguous_format) for name, tensor in tensors.items()
    }
    write_atomically(path, save(copies, metadata={"info": json.dumps(info)}))


def _read_tensors(path: Path, expect: Expect | None = None) -> tuple[State, Info]:
    if not path.exists():
        raise CorruptFile(f"{path} is missing, though there is a {CONFIG}; {_MEND[path.name]}")
    tensors, metadata = read_tensors(path, _MEND[path.name], expect)
    try:
        info = parse_json(metadata["info"])
        if not isinstance(info, dict):
            raise ValueError("its info is no group of values")
    except (ValueError, KeyError) as error:
        raise CorruptFile(f"{path} is damaged ({brief_reason(error)}); {_MEND[path.name]}") from None
    return tensors, info
