"""Weights that ship with the package, in `assets/checkpoints/MODEL--TRACK--WIDTHxHEIGHT/`.

They are as `obpose.checkpoint` saves them; the command that made them stands in a README beside each.
"""

import hashlib
from pathlib import Path

import assets
from datagen.safe_io import read_bytes
from obpose.errors import UsageError

MOST_BYTES = 4 * 2**30
"""Largest file of weights."""


def shipped_name(model: str, track: str, resolution: tuple[int, int]) -> str:
    """Folder of the weights of a model that was trained on a track at a width and height."""
    width, height = resolution
    return f"{model}--{track}--{width}x{height}"


def shipped_names() -> list[str]:
    """What there is."""
    return sorted(path.name for path in assets.CHECKPOINTS.glob("*--*--*x*") if path.is_dir())


def list_shipped() -> str:
    """What there is, as a sentence."""
    names = shipped_names()
    return f"There are: {', '.join(names)}." if names else "There are none at all."


def find_shipped(model: str, track: str, resolution: tuple[int, int]) -> Path:
    """Folder of such weights.

    Raises:
        UsageError: there are none; says which there are.
    """
    name = shipped_name(model, track, resolution)
    if name in shipped_names():
        return assets.CHECKPOINTS / name
    width, height = resolution
    raise UsageError(
        f"No weights of {model!r} trained on {track!r} at {width}x{height} ship with this package. {list_shipped()} "
        "Name the track that they were trained on with --fit-track, or train without --pretrained."
    )


def shipped_to_create(track: str) -> str:
    """Name of the weights to make pictures with on a track: of `obpose-sharp`, or of `obpose` where there are none.

    Raises:
        UsageError: there are neither.
    """
    for model in ("obpose-sharp", "obpose"):
        for name in shipped_names():
            if name.startswith(f"{model}--{track}--"):
                return name
    raise UsageError(
        f"No weights of obpose for {track} ship with this package; say with --checkpoint which to use. {list_shipped()}"
    )


def find_checkpoint(checkpoint: Path) -> Path:
    """The folder of a model: the one that is named, or the weights that ship under this name.

    Raises:
        UsageError: there is neither; says what there is.
    """
    if not checkpoint.exists() and str(checkpoint) in shipped_names():
        return assets.CHECKPOINTS / checkpoint
    if not checkpoint.is_dir():
        raise UsageError(
            f"--checkpoint {checkpoint}: no such folder; expected one that obpose-train wrote, or the name of weights "
            f"that ship with this package. {list_shipped()}"
        )
    return checkpoint


def content_hash(folder: Path) -> str:
    """SHA-256 of names and contents of the files in a folder that hold the model's weights and its configuration.

    Raises:
        UsageError: one of them is no regular file.
        CorruptFile: one of them is too large.
    """
    found = hashlib.sha256()
    for path in (folder / "config.json", folder / "model.safetensors"):
        if path.exists():
            found.update(f"{path.name}|{hashlib.sha256(read_bytes(path, MOST_BYTES)).hexdigest()}|".encode())
    return found.hexdigest()
