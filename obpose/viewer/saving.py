"""Scenes of the viewer on disk: every one in a folder of its own, nothing is overwritten."""

from contextlib import suppress
from itertools import count
from pathlib import Path

from obpose.errors import DatagenError, UsageError
from obpose.scenes.bounds import check_inside
from obpose.scenes.pictures import strip
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Scene
from obpose.scenes.storage import save_scene


def save_new(root: Path, scene: Scene, renderer: Renderer) -> Path:
    """Write a scene and its picture, as `obpose-edit` does, into the first folder `scene-N` that is not there yet.

    Raises:
        UsageError: `root` is a file, or an object is where the model knows nothing.
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
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise AssertionError("there is always another number")
