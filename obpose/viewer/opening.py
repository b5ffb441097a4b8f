"""Opening of a path in the viewer: detection of its kind, and the first scene to show."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from datagen.console.text import counted
from obpose.data.datasets import SceneDataset
from obpose.errors import UsageError
from obpose.scenes.clip import name_clip, read_clip
from obpose.scenes.infer import infer_scene
from obpose.scenes.model_ref import Origin, load_origin, origin_of
from obpose.scenes.scene import ClipName, Scene
from obpose.scenes.storage import FACTS, load_scene
from obpose.storage.checkpoint import CONFIG
from obpose.storage.pretrained import list_shipped, shipped_names, shipped_to_create
from obpose.types import Observation

Kind = Literal["scene", "model", "dataset"]


@dataclass(frozen=True, eq=False)
class Opened:
    """A scene with its model, and with the clip it was inferred from if that is available."""

    scene: Scene
    origin: Origin
    clip: Observation | None
    """The clip as a batch of one."""
    title: str
    is_inferred: bool
    """Whether the scene was just inferred from the clip and is unedited."""


def open_path(path: Path, *, checkpoint: str | None, data: Path | None, split: str, index: int) -> Opened:
    """Load a saved scene, or infer one from a clip of a dataset, or of `data` if the path is a model.

    Raises:
        UsageError: the path is none of these, or another argument is missing or contradicts it.
        CorruptFile: a file is damaged.
    """
    kind = check_request(path, checkpoint=checkpoint, data=data)
    if kind == "scene":
        return _open_scene(path, checkpoint, data, split, index)
    if kind == "model":
        assert data is not None
        return _infer(str(path), data, split, index)
    return _infer(checkpoint or shipped_to_create(SceneDataset(path, "test").recipe), path, split, index)


def check_request(path: Path, *, checkpoint: str | None, data: Path | None) -> Kind:
    """Check that the arguments fit the kind of the path, before anything is opened; give the kind.

    Raises:
        UsageError: the path cannot be shown, or an argument is missing or contradicts it.
    """
    kind = kind_of(path)
    if kind == "model" and checkpoint is not None:
        raise UsageError(f"{path} is a trained model itself; leave out --checkpoint, or give a dataset instead.")
    if kind == "model" and data is None:
        raise UsageError(f"{path} is a trained model; say with --data DIR which dataset's scenes to look at.")
    if kind == "dataset" and data is not None:
        raise UsageError(f"{path} is a dataset itself; leave out --data, or give a trained model instead.")
    return kind


def kind_of(path: Path) -> Kind:
    """Detect the kind of a path by the files in it.

    Raises:
        UsageError: the path cannot be shown.
    """
    if (path / FACTS).is_file():
        return "scene"
    if (path / CONFIG).is_file() or (not path.exists() and str(path) in shipped_names()):
        return "model"
    if not path.exists():
        raise UsageError(f"{path}: no such folder; {_EXPECTED}. {list_shipped()}")
    if not path.is_dir():
        raise UsageError(f"{path} is a file; {_EXPECTED}.")
    return "dataset"


_EXPECTED = (
    "expected one of a dataset (obpose-datagen), of a scene (obpose-edit), or of a trained model (obpose-train or the "
    "name of weights that ship)"
)


def _infer(checkpoint: str, data: Path, split: str, index: int) -> Opened:
    clip = read_clip(data, split, index)
    origin = load_origin(checkpoint)
    scene = replace(infer_scene(origin, clip), clip=name_clip(data, split, index))
    return Opened(scene, origin, clip, f"{data.resolve().name}, {split} {index}", is_inferred=True)


def _open_scene(path: Path, checkpoint: str | None, data: Path | None, split: str, index: int) -> Opened:
    scene = load_scene(path)
    clip = None if data is None else read_clip(data, split, index)
    if data is not None:
        _check_clip(path, scene, data, name_clip(data, split, index))
    if clip is not None and clip.depth.shape[1:3] != (scene.frames, len(scene.cameras)):
        frames, views = clip.depth.shape[1:3]
        raise UsageError(
            f"Scene {index} of {data} has {counted(frames, 'frame')} and {counted(views, 'view')}, {path} has "
            f"{scene.frames} and {len(scene.cameras)}; give the clip that it was inferred from, or leave out --data."
        )
    return Opened(scene, origin_of(scene, checkpoint), clip, path.resolve().name, is_inferred=False)


def _check_clip(path: Path, scene: Scene, data: Path, given: ClipName) -> None:
    """Check that a scene was inferred from the given clip, if the scene names its clip."""
    if scene.clip is None or scene.clip == given:
        return
    if scene.clip.dataset == given.dataset:
        wrong, right = f"{given}", f"--split {scene.clip.split} --scene {scene.clip.index}"
    else:
        wrong, right = f"any in {data}", "the dataset that it is of with --data"
    raise UsageError(f"{path} is of {scene.clip}, not of {wrong}; give {right}, or leave out --data.")
