"""Subcommands of `obpose-edit`: infer, sample, change and render scenes of a trained model."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from joblib import cpu_count
from torch import Tensor

import assets
from datagen.console.text import counted
from datagen.storage.atomic import check_new_file, check_new_folder, new_file
from obpose.commands.edit_arguments import Add, FitPrior, Infer, Mesh, Move, Render, Rotate, Sample
from obpose.contact.scene_model import ContactObPose
from obpose.data.datasets import SceneDataset
from obpose.errors import Interrupted, UsageError
from obpose.geometry import unproject
from obpose.model.resolution import spacing_note
from obpose.rgbd.frames import PreparedFrames, prepare, trained_on
from obpose.rgbd.reading import read_frames
from obpose.rgbd.results import objects_of, width_warnings
from obpose.rgbd.weights import DEFAULT, segment_clip, segment_reduced
from obpose.scenes import edit
from obpose.scenes.appearance.light import strength
from obpose.scenes.bounds import check_inside, objects_outside
from obpose.scenes.clip import name_clip, one_of, read_clip
from obpose.scenes.infer import infer_scene, views_as_trained
from obpose.scenes.meshes import FORMATS, object_mesh, write_mesh
from obpose.scenes.model_ref import Origin, load_origin, origin_of
from obpose.scenes.pictures import PICTURE, strip, strips, turned, turntable, write_gif, write_png
from obpose.scenes.priors import PRIORS, load_prior
from obpose.scenes.priors.interface import FitSettings
from obpose.scenes.priors.sample import default_camera, sample_scene
from obpose.scenes.rendering import Image, Renderer
from obpose.scenes.scene import Camera, Scene, axis_rotation
from obpose.scenes.storage import load_scene, save_scene
from obpose.storage.pretrained import shipped_to_create

FPS = 8.0
MOST_OBJECTS = 100
MOST_CELLS = 256
MOST_REFINEMENTS = 10_000
MOST_TURNS = 360
MOST_STEPS = 10_000_000
MOST_SEEDS = 2**31
LARGEST = 2048
"""Largest width and height of a picture, pixels."""


OWN = "own"
"""Value of --masks with which the model finds the objects itself."""


def infer(values: Infer) -> None:
    """Infer a scene and write it."""
    # Flags, before the weights are loaded.
    framed = any((values.source, values.rgb, values.depth, values.intrinsics, values.camera_pose))
    if framed == (values.data is not None):
        raise UsageError(
            "Say what to infer from: either --data DIR, or --rgb, --depth and --intrinsics of your own, or a folder."
        )
    if not 0 <= values.refine <= MOST_REFINEMENTS:
        raise UsageError(f"--refine {values.refine}: expected 0 to {MOST_REFINEMENTS}.")
    _size(values.resolution)
    origin = load_origin(values.checkpoint or _default_weights(values))
    if values.data is not None:
        # A clip of a dataset.
        place = (values.data, values.split, values.scene)
        clip = read_clip(*place)
        check_new_folder(values.out)
        print(f"Weights: {origin.name}.\nResolution: {spacing_note(origin.model, clip)}.")
        labels = (
            None if values.masks in (None, OWN) else segment_clip(values.masks, views_as_trained(origin.model, clip))
        )
        scene = infer_scene(origin, clip, refinements=values.refine, labels=labels)
        scene = replace(scene, clip=name_clip(*place))
    else:
        # Frames of the user.
        frames = prepare(read_frames(values), values, trained_on(origin.model.config))
        check_new_folder(values.out)
        if frames.moves:
            raise UsageError("The camera moves in these frames; expected frames of a static camera, or a single one.")
        masks = values.masks or DEFAULT
        print(f"Weights: {origin.name}; masks: {'their own' if masks == OWN else masks}.")
        print(f"World: {frames.world.note}.\nResolution: {frames.resolution}.")
        # The contact model's own masks also go through the filters of frames, which drop bumps of the table.
        finder = origin.name if masks == OWN and isinstance(origin.model, ContactObPose) else masks
        labels = None if finder == OWN else segment_reduced(finder, values, frames)
        for warning in [*frames.warnings, *([] if labels is None else _wide(labels, frames))]:
            print(f"Warning: {warning}")
        scene = infer_scene(origin, frames.observation, refinements=values.refine, labels=labels)
        for name in [] if labels is None else sorted({*labels.unique().tolist()} - {0, *scene.ids}):
            print(
                f"Object {name} of the masks is left out: it is outside of the workspace of the weights, or too small."
            )
    for name in objects_outside(scene, origin.model):
        print(f"Object {name} is left out: it is at the border of the workspace of the weights.")
        scene = edit.remove(scene, name)
    _show(scene, origin, values.out, values.resolution)
    if not scene.ids:
        print("No object was found: there is none, or the weights were trained too little or on other scenes.")
    elif values.refine and not strength(scene.appearance.light):
        print("No light was found by its shadows: the scene is drawn without any.")


def _wide(labels: Int[Tensor, "1 frame 1 height width"], frames: PreparedFrames) -> list[str]:
    """Warn of masks that are wider than an object should be."""
    points = unproject(frames.observation)[0, :, 0].numpy()
    return width_warnings([objects_of(*pair) for pair in zip(labels[0, :, 0].numpy(), points, strict=True)])


def _default_weights(values: Infer) -> str:
    """Name the shipped weights for a dataset, or for frames of the user."""
    recipe = "moving" if values.data is None else SceneDataset(values.data, values.split).recipe
    return shipped_to_create(recipe)


def sample(values: Sample) -> None:
    """Sample a scene and write it."""
    if not 0 <= values.objects <= MOST_OBJECTS:
        raise UsageError(f"--objects {values.objects}: expected 0 to {MOST_OBJECTS}.")
    if not 0 <= values.seed < 2**63:
        raise UsageError(f"--seed {values.seed}: expected 0 or more, and less than 2^63.")
    _size(values.resolution)
    cameras = None if values.camera is None else load_scene(values.camera).cameras
    origin, generator = load_origin(values.checkpoint), torch.Generator().manual_seed(values.seed)
    prior, cameras = load_prior(origin, values.prior), cameras or (default_camera(),)
    scene = sample_scene(origin, prior, objects=values.objects, cameras=cameras, generator=generator)
    _show(scene, origin, values.out, values.resolution)


def fit_prior(values: FitPrior) -> None:
    """Fit a prior and write it beside the weights."""
    kind, origin = PRIORS[values.kind], _own(values.checkpoint)
    assert kind.fit is not None
    assert kind.file is not None
    count = _clips(values, kind.clips)
    if not 1 <= values.steps <= MOST_STEPS:
        raise UsageError(f"--steps {values.steps}: expected 1 to {MOST_STEPS}.")
    if not 0 <= values.seed < MOST_SEEDS:
        raise UsageError(f"--seed {values.seed}: expected 0 to {MOST_SEEDS - 1}.")
    if values.workers is not None and values.workers < 1:
        raise UsageError(f"--workers {values.workers}: expected at least 1.")
    if (origin.folder / kind.file).is_file():
        raise UsageError(f"{origin.folder / kind.file} exists; move it elsewhere to fit another one.")
    settings = FitSettings(count, values.steps, values.seed, values.workers or cpu_count())
    try:
        path = kind.fit(origin, values.data, settings, _say)
    except KeyboardInterrupt:
        kept = "what was done is kept, and the same command resumes" if values.kind == "flow" else "nothing was changed"
        raise Interrupted(f"Interrupted; {kept}.") from None
    print(f"Fitted to {counted(count, 'clip')}, for obpose-edit sample: {path}")


def _say(line: str) -> None:
    print(line, flush=True)


def _own(checkpoint: str) -> Origin:
    """Load a model beside whose weights files may be written."""
    origin = load_origin(checkpoint)
    if origin.folder.resolve().parent == assets.CHECKPOINTS.resolve():
        raise UsageError(
            f"{origin.folder} ships with the package, its prior too; use a copy of the folder without these."
        )
    return origin


def _clips(values: FitPrior, default: int) -> int:
    """Give the number of training clips to use: as many as requested, or all if there are fewer."""
    number, wanted = len(SceneDataset(values.data, "train")), default if values.clips is None else values.clips
    if min(wanted, number) < 2:
        raise UsageError(
            f"--clips {wanted}: expected 2 or more, of the training split of {values.data}, which has {number}."
        )
    if wanted > number:
        _say(f"{values.data} has {number} training clips, fewer than --clips {wanted}.")
    return min(wanted, number)


def render(values: Render) -> None:
    """Render a scene into a picture or an animation."""
    if values.turntable is not None and not 0 < values.turntable <= MOST_TURNS:
        raise UsageError(f"--turntable {values.turntable}: expected 1 to {MOST_TURNS}.")
    if not math.isfinite(values.beside):
        raise UsageError(f"--beside {values.beside}: expected a finite number.")
    if values.clip and (values.turntable is not None or values.frame is not None):
        raise UsageError("--clip shows all frames from where the camera is; leave out --turntable and --frame, or it.")
    moving = values.turntable is not None or values.clip
    if values.out.suffix != (".gif" if moving else ".png"):
        expected = ".gif" if moving else ".png, or --turntable or --clip for an animation"
        raise UsageError(f"--out {values.out}: expected a name that ends with {expected}.")
    scene = load_scene(values.scene)
    frame = one_of("--frame", values.frame or 0, scene.frames)
    camera = scene.cameras[one_of("--view", values.view, len(scene.cameras))]
    origin = origin_of(scene, values.checkpoint)
    camera = turned(_sized(camera, values.resolution), origin.model.center, math.radians(values.beside))
    check_new_file(values.out)
    renderer = Renderer(origin.model)
    with new_file(values.out) as out:
        if values.turntable is not None:
            around = turntable(camera, origin.model.center, values.turntable)
            medians: list[float] = []

            def rendered(each: Camera) -> Image:
                image = renderer.render(scene, frame, each)
                medians.append(float(image.depth.median()))
                return image

            write_gif(out, strips(map(rendered, around), scene.ids), fps=FPS)
            _tell_of_fog(medians, float((origin.model.center - camera.world_from_camera[:3, 3]).norm()))
        elif values.clip:
            images = (renderer.render(scene, each, camera) for each in range(scene.frames))
            write_gif(out, strips(images, scene.ids), fps=FPS)
        else:
            write_png(out, strip(renderer.render(scene, frame, camera), scene.ids))
    print(values.out)


def _tell_of_fog(depths: list[float], distance: float) -> None:
    """Warn if fog hides a scene that is `distance` metres away from the cameras, by the pictures' median depths."""
    if fogged := sum(depth < distance / 2 for depth in depths):
        print(
            f"In {fogged} of {counted(len(depths), 'picture')} there is fog before the scene: the fields of "
            "these weights are empty only where training cameras looked. Use weights that were trained with several "
            "views for turntables."
        )


def mesh(values: Mesh) -> None:
    """Write the surface of an object."""
    if values.out.suffix not in FORMATS:
        raise UsageError(f"--out {values.out}: expected a name that ends with {' or '.join(FORMATS)}.")
    if not 2 <= values.cells <= MOST_CELLS:
        raise UsageError(f"--cells {values.cells}: expected 2 to {MOST_CELLS}.")
    scene = load_scene(values.scene)
    frame = one_of("--frame", values.frame, scene.frames)
    model = origin_of(scene, values.checkpoint).model
    scene.place(values.object)
    check_new_file(values.out)
    floor = model.config.model.table
    mesh = object_mesh(model, scene, values.object, frame=frame, resolution=values.cells, floor=floor)
    with new_file(values.out) as out:
        write_mesh(out, mesh)
    along = np.ptp(mesh.vertices @ scene.rotation[frame, scene.place(values.object)].numpy(), axis=0)
    sides = " x ".join(f"{100 * side:.1f}" for side in along)
    print(f"{values.out}: {counted(len(mesh.faces), 'triangle')}, {sides} cm along the axes of the object's box")


def _edited(change: Callable[[Any, Scene], Scene]) -> Callable[[Any], None]:
    """Make a command that loads a scene, changes it, and writes the result."""

    def command(values: Any) -> None:
        scene = load_scene(values.scene)
        changed = change(values, scene)
        _show(changed, origin_of(scene, values.checkpoint), values.out, values.resolution)

    return command


def _move(values: Move, scene: Scene) -> Scene:
    if (values.by is None) == (values.to is None):
        raise UsageError("Give either --by or --to.")
    if values.by is not None:
        return edit.move(scene, values.object, _vector("--by", values.by))
    return edit.move_to(scene, values.object, _vector("--to", values.to))


def _rotate(values: Rotate, scene: Scene) -> Scene:
    if not math.isfinite(values.degrees):
        raise UsageError(f"--degrees {values.degrees}: expected a finite number.")
    return edit.rotate(scene, values.object, axis_rotation(values.axis, math.radians(values.degrees), scene.center))


def _add(values: Add, scene: Scene) -> Scene:
    source = scene if values.source is None else load_scene(values.source)
    if values.by is not None and values.to is not None:
        raise UsageError("Give --by or --to, not both.")
    added = edit.transfer(source, values.object, scene)
    if values.by is not None:
        added = edit.move(added, added.ids[-1], _vector("--by", values.by))
    if values.to is not None:
        added = edit.move_to(added, added.ids[-1], _vector("--to", values.to))
    # A copy that coincides with an equal object would be invisible.
    parts = (added.what, added.center, added.rotation)
    for place, name in enumerate(added.ids[:-1]):
        if all(torch.equal(part[:, place], part[:, -1]) for part in parts):
            raise UsageError(f"A copy in the same place as object {name} would not be seen; give --by or --to.")
    return added


def _show(scene: Scene, origin: Origin, out: Path, resolution: str | None) -> None:
    """Check, render, write and describe a scene."""
    check_inside(scene, origin.model)
    camera = _sized(scene.cameras[0], resolution)
    check_new_folder(out)
    image = Renderer(origin.model).render(scene, 0, camera)
    save_scene(out, scene, strip(image, scene.ids))
    print(f"{out}: {counted(scene.frames, 'frame')}, {counted(len(scene.ids), 'object')}; {out / PICTURE}")
    for place, name in enumerate(scene.ids):
        x, y, z = scene.center[0, place].tolist()
        hidden = "" if (image.nearest == place + 1).any() else ", where it is hidden or outside of the picture"
        print(f"  object {name} at {x:.3f}, {y:.3f}, {z:.3f} m in the first frame{hidden}")


def _vector(flag: str, text: str | None) -> Float[Tensor, "3"]:
    try:
        numbers = [float(part) for part in (text or "").split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise UsageError(f"{flag} {text}: expected x,y,z in metres, such as 0.1,0,0.")
    return torch.tensor(numbers)


def _sized(camera: Camera, resolution: str | None) -> Camera:
    return camera.resized(*(_size(resolution) or (camera.width, camera.height)))


def _size(resolution: str | None) -> tuple[int, int] | None:
    """Parse and check width and height."""
    if resolution is None:
        return None
    try:
        width, height = (int(part) for part in resolution.lower().split("x"))
    except ValueError:
        width = height = 0
    if not (0 < width <= LARGEST and 0 < height <= LARGEST):
        raise UsageError(f"--resolution {resolution}: expected WIDTHxHEIGHT, such as 128x128, at most {LARGEST}.")
    return width, height


remove = _edited(lambda values, scene: edit.remove(scene, values.object))
move = _edited(_move)
rotate = _edited(_rotate)
swap = _edited(lambda values, scene: edit.swap(scene, *values.objects))
add = _edited(_add)
