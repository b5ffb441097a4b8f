"""Sources and destination of the viewer's scenes: open a path, sample from a prior, save to a new folder."""

from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Literal

import torch

from datagen.console.text import counted
from obpose.data.datasets import SceneDataset
from obpose.errors import DatagenError, UsageError
from obpose.scenes.bounds import check_inside
from obpose.scenes.clip import name_clip, read_clip
from obpose.scenes.infer import infer_scene
from obpose.scenes.model_ref import Origin, load_origin, origin_of
from obpose.scenes.pictures import strip
from obpose.scenes.priors import load_prior
from obpose.scenes.priors.interface import ScenePrior
from obpose.scenes.priors.sample import sample_scene
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Camera, ClipName, Scene, Split
from obpose.scenes.storage import FACTS, load_scene, save_scene
from obpose.storage.checkpoint import CONFIG
from obpose.storage.pretrained import list_shipped, shipped_names, shipped_to_create
from obpose.types import Observation

_EXPECTED = (
    "expected a dataset (obpose-datagen), a scene (obpose-edit), or a trained model (obpose-train or the name of "
    "shipped weights)"
)


@dataclass(frozen=True, eq=False)
class OpenedScene:
    """A scene with its model, and with the clip it was inferred from if that is available."""

    scene: Scene
    origin: Origin
    clip: Observation | None
    """The clip as a batch of one."""
    title: str
    is_inferred: bool
    """Whether the scene was just inferred from the clip and is unedited."""


def open_path(path: Path, *, checkpoint: str | None, data: Path | None, split: Split, index: int) -> OpenedScene:
    """Load a saved scene, or infer one from a clip of a dataset, or of `data` if the path is a model.

    A dataset without `checkpoint` uses the shipped weights that render best for its recipe.

    Raises:
        UsageError: the path is none of these, or another argument is missing or contradicts it.
        CorruptFile: a file is damaged.
    """
    kind = _kind_of(path)
    if kind == "scene":
        return _open_scene(path, checkpoint, data, split, index)
    if kind == "model":
        if checkpoint is not None:
            raise UsageError(f"{path} is a trained model itself; leave out --checkpoint, or give a dataset instead.")
        if data is None:
            raise UsageError(f"{path} is a trained model; say with --data DIR which dataset's scenes to look at.")
        return _infer(str(path), data, split, index)
    if data is not None:
        raise UsageError(f"{path} is a dataset itself; leave out --data, or give a trained model instead.")
    return _infer(checkpoint or shipped_to_create(SceneDataset(path, "test").recipe), path, split, index)


def _kind_of(path: Path) -> Literal["scene", "model", "dataset"]:
    """Detect the kind of a path by the files in it."""
    if (path / FACTS).is_file():
        return "scene"
    if (path / CONFIG).is_file() or (not path.exists() and str(path) in shipped_names()):
        return "model"
    if not path.exists():
        raise UsageError(f"{path}: no such folder; {_EXPECTED}. {list_shipped()}")
    if not path.is_dir():
        raise UsageError(f"{path} is a file; {_EXPECTED}.")
    return "dataset"


def _infer(checkpoint: str, data: Path, split: Split, index: int) -> OpenedScene:
    clip = read_clip(data, split, index)
    origin = load_origin(checkpoint)
    scene = replace(infer_scene(origin, clip), clip=name_clip(data, split, index))
    return OpenedScene(scene, origin, clip, f"{data.resolve().name}, {split} {index}", is_inferred=True)


def _open_scene(path: Path, checkpoint: str | None, data: Path | None, split: Split, index: int) -> OpenedScene:
    scene, clip = load_scene(path), None
    if data is not None:
        clip = read_clip(data, split, index)
        _check_clip(path, scene, data, name_clip(data, split, index))
        frames, views = clip.depth.shape[1:3]
        if (frames, views) != (scene.frames, len(scene.cameras)):
            raise UsageError(
                f"Scene {index} of {data} has {counted(frames, 'frame')} and {counted(views, 'view')}, {path} has "
                f"{scene.frames} and {len(scene.cameras)}; give the clip that it was inferred from, or leave out "
                "--data."
            )
    return OpenedScene(scene, origin_of(scene, checkpoint), clip, path.resolve().name, is_inferred=False)


def _check_clip(path: Path, scene: Scene, data: Path, given: ClipName) -> None:
    """Check that a scene was inferred from the given clip, if the scene names its clip."""
    if scene.clip is None or scene.clip == given:
        return
    if scene.clip.dataset == given.dataset:
        wrong, right = f"{given}", f"--split {scene.clip.split} --scene {scene.clip.index}"
    else:
        wrong, right = f"any scene of {data}", "its own dataset with --data"
    raise UsageError(f"{path} was inferred from {scene.clip}, not from {wrong}; give {right}, or leave out --data.")


class Sampler:
    """Sampler of new scenes from the best prior of a model, with the seeds 0, 1, 2 and so on."""

    def __init__(self, origin: Origin):
        self._origin = origin
        self._prior: ScenePrior | None = None
        self.seed = -1
        """Seed of the newest scene; -1 before the first."""

    def next(self, objects: int, cameras: tuple[Camera, ...]) -> Scene:
        """Sample a scene with the next seed.

        Raises:
            UsageError: there is no room for this many objects.
            CorruptFile: the file of a prior is damaged.
        """
        if self._prior is None:
            self._prior = load_prior(self._origin)
        self.seed += 1
        generator = torch.Generator().manual_seed(self.seed)
        return sample_scene(self._origin, self._prior, objects=objects, cameras=cameras, generator=generator)


def save_new(root: Path, scene: Scene, renderer: Renderer) -> Path:
    """Write a scene and its picture into the first folder `scene-N` that does not exist; give the folder.

    Raises:
        UsageError: `root` is a file, or an object is outside the workspace.
        DatagenError: it cannot be written, for example because the disk is full.
    """
    check_inside(scene, renderer.model)
    picture = strip(renderer.render(scene), scene.ids)
    folder = _new_folder(root)
    try:
        save_scene(folder, scene, picture)
    except DatagenError:
        with suppress(OSError):
            folder.rmdir()
        raise
    return folder


def _new_folder(root: Path) -> Path:
    if root.exists() and not root.is_dir():
        raise UsageError(f"{root} is a file; expected a folder, or a place for a new one: give another --out.")
    root.mkdir(parents=True, exist_ok=True)
    for number in count(1):
        folder = root / f"scene-{number}"
        with suppress(FileExistsError):
            folder.mkdir()
            return folder
    raise AssertionError("unreachable")
