"""Weights that ship with the package, in `assets/checkpoints/MODEL--TRACK--WIDTHxHEIGHT/`.

They have the format of `obpose.storage.checkpoint`; a README beside each gives the command that made it.
"""

import hashlib
from pathlib import Path

import assets
from datagen.storage.safe_io import read_bytes
from obpose.errors import UsageError

MOST_BYTES = 4 * 2**30
"""Largest size of a file of weights, bytes."""


def shipped_name(model: str, track: str, resolution: tuple[int, int]) -> str:
    """Folder name of the weights of a model trained on a track at a resolution, width and height in pixels."""
    width, height = resolution
    return f"{model}--{track}--{width}x{height}"


def shipped_names(folder: Path = assets.CHECKPOINTS) -> list[str]:
    """List the names of all weights in a folder, by default of those that ship with the package."""
    return sorted(path.name for path in folder.glob("*--*--*x*") if path.is_dir())


def list_shipped(folder: Path = assets.CHECKPOINTS) -> str:
    """List the names of all shipped weights in a sentence, for messages."""
    names = shipped_names(folder)
    return f"There are: {', '.join(names)}." if names else "There are none at all."


def find_shipped(model: str, track: str, resolution: tuple[int, int]) -> Path:
    """Find the folder of shipped weights by model, track and resolution.

    Raises:
        UsageError: there are none; the message lists the available names.
    """
    name = shipped_name(model, track, resolution)
    if name in shipped_names():
        return assets.CHECKPOINTS / name
    width, height = resolution
    raise UsageError(
        f"No weights of {model!r} trained on {track!r} at {width}x{height} ship with this package. {list_shipped()} "
        "Name the track that they were trained on with --fit-track, or train without --pretrained."
    )


def shipped_to_create(track: str, folder: Path = assets.CHECKPOINTS) -> str:
    """Name of the weights for pictures of a track: those of `obpose-contact`, otherwise of `obpose`.

    Raises:
        UsageError: neither exists.
    """
    for model in ("obpose-contact", "obpose"):
        for name in shipped_names(folder):
            if name.startswith(f"{model}--{track}--"):
                return name
    raise UsageError(
        f"No weights of obpose-contact or obpose for {track} ship with this package; name others with --checkpoint. "
        f"{list_shipped(folder)}"
    )


def find_checkpoint(checkpoint: Path, *, option: str = "--checkpoint") -> Path:
    """Find the folder of a model that an option gives as a path or as the name of shipped weights.

    Raises:
        UsageError: neither exists; the message lists the available names.
    """
    if not checkpoint.exists() and str(checkpoint) in shipped_names():
        return assets.CHECKPOINTS / checkpoint
    if not checkpoint.is_dir():
        raise UsageError(
            f"{option} {checkpoint}: no such folder; expected one that obpose-train wrote, or the name of weights "
            f"that ship with this package. {list_shipped()}"
        )
    return checkpoint


def content_hash(folder: Path) -> str:
    """SHA-256 of the names and contents of a model's weights and configuration.

    Raises:
        UsageError: one of the files is no regular file.
        CorruptFile: one of them is too large.
    """
    found = hashlib.sha256()
    for path in (folder / "config.json", folder / "model.safetensors"):
        if path.exists():
            found.update(f"{path.name}|{hashlib.sha256(read_bytes(path, MOST_BYTES)).hexdigest()}|".encode())
    return found.hexdigest()
