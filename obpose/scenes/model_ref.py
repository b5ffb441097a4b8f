"""References to the model that a scene's latents belong to."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from obpose.config import Config
from obpose.errors import CorruptFile, UsageError
from obpose.model.layers.latent import LATENT
from obpose.model.obpose import ObPose
from obpose.scenes.scene import Scene
from obpose.storage.checkpoint import MODEL, load_obpose, read_config
from obpose.storage.pretrained import find_checkpoint
from obpose.systems import SYSTEMS, architecture_of
from obpose.trainable import Configuration


@dataclass(frozen=True, eq=False)
class Origin:
    """A model whose objects have poses, with its place and its hash."""

    model: ObPose
    folder: Path
    name: str
    """Place as given by the user."""
    hash: str
    """SHA-256 of the file of its weights."""


def load_origin(checkpoint: str) -> Origin:
    """Load the model of a folder, or of weights that ship under this name.

    Raises:
        UsageError: there is no model, or its objects have no poses.
        CorruptFile: a file is damaged.
    """
    folder = find_checkpoint(Path(checkpoint))
    check_poses(read_config(folder), checkpoint)
    model = load_obpose(folder)
    return Origin(model, folder, checkpoint, hashlib.sha256((folder / MODEL).read_bytes()).hexdigest())


def check_poses(config: Configuration, place: str) -> None:
    """Check that the objects of a model with this configuration have poses.

    Raises:
        UsageError: the objects have no poses.
    """
    if _has_poses(config):
        return
    if isinstance(config, Config):
        what = f"with model.pose.conditioning={config.model.pose.conditioning}"
    else:
        what = f"of the architecture {architecture_of(config).name}"
    expected = ", ".join(name for name, system in SYSTEMS.items() if _has_poses(system.config()))
    raise UsageError(
        f"{place} holds a model {what}, whose objects have no pose that could be edited; give one of {expected}."
    )


def _has_poses(config: Configuration) -> bool:
    return isinstance(config, Config) and config.model.pose.conditioning in ("location", "full")


def origin_of(scene: Scene, checkpoint: str | None = None) -> Origin:
    """Load the model of a scene from the place that the scene names, or from `checkpoint`.

    Raises:
        UsageError: as in `load_origin`, or the weights differ from those that made the scene.
        CorruptFile: a file or the scene is damaged.
    """
    place = checkpoint or scene.checkpoint
    try:
        found = load_origin(place)
    except UsageError as error:
        if checkpoint is not None:
            raise
        raise UsageError(f"The scene's model was not found: {error} Give its place with --checkpoint.") from None
    if found.hash != scene.model:
        raise UsageError(
            f"The scene was made with other weights than those in {place}, whose codes differ. Give "
            "--checkpoint with the right ones, or infer the scene again."
        )
    if (scene.what.shape[-1], scene.background.shape[-1]) != (LATENT, LATENT):
        raise CorruptFile(
            f"The scene is damaged: its latents have {scene.what.shape[-1]} and {scene.background.shape[-1]} values, "
            f"those of its model {LATENT}; make it again, into another folder."
        )
    return found
