"""Make all arrays of one scene, as a pure function of the spec, the split and the index."""

import dataclasses
import functools
import math
import uuid
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from datagen.config import Recipe
from datagen.edits import edits_record
from datagen.edits.edit_context import stage_of
from datagen.errors import CorruptFile, UsageError
from datagen.meshes.library import Library
from datagen.pipeline.records import pixel_record, scene_and_trajectory, simulation_record, with_scene
from datagen.random_streams import Stream, scene_rng
from datagen.render import SAMPLES, make_renderer
from datagen.render.renderer import PathTracer, Renderer, photographs
from datagen.render.visible_range import check_range
from datagen.sampling.cameras import sample_cameras
from datagen.scene import Camera, Scene, Trajectory
from datagen.schema import FIELDS, SPLITS, SceneRecord
from datagen.shapes import build
from datagen.signals import signals_record
from datagen.storage.cameras_file import cameras_from_values
from datagen.storage.reader import Dataset, Split
from datagen.storage.shard import PackedScene, pack
from datagen.storage.spec import (
    BYTES_PER_SIGNAL_PIXEL,
    Spec,
    compression_of,
    edits_of,
    recipe_of,
    rendered_recipe_of,
    signals_of,
    views_of,
)

MOST_MEMORY = 4 * 2**30
"""Largest memory of one scene while it is made, bytes; every worker makes one scene at a time."""


MOST_SAMPLES = 65_536
"""Largest number of paths per pixel."""

_SIMULATED = ("simulation", "moving_camera")
"""Groups of fields that need no images."""


@dataclass(frozen=True)
class Source:
    """Dataset whose scenes are rendered again."""

    folder: Path
    settings: str
    """Settings hash of the dataset."""
    run: str = field(default_factory=lambda: uuid.uuid4().hex)
    """Random identifier of the run, so that each run reopens the files."""


@dataclass(frozen=True)
class SceneMaker:
    """Make the scenes of a dataset, ready to be stored; can be called in any process."""

    spec: Spec
    source: Source | None = None
    """Dataset that the simulation fields are read from; None simulates."""
    meshes: Library | None = None
    """Meshes of the dataset."""

    def __call__(self, split: str, index: int) -> PackedScene:
        """Make one scene.

        Raises:
            UsageError: another dataset has taken the source's folder.
            CorruptFile: a scene of the source cannot be read or built.
        """
        record = make_scene(self.spec, split, index, self._source_record(split, index), self.meshes)
        return pack(record, compression_of(self.spec))

    def with_absolute_paths(self) -> "SceneMaker":
        """Copy for processes that have other working directories."""
        source, meshes = self.source, self.meshes
        return dataclasses.replace(
            self,
            source=source and dataclasses.replace(source, folder=source.folder.absolute()),
            meshes=meshes and dataclasses.replace(meshes, folder=meshes.folder.absolute()),
        )

    def check_inputs(self) -> None:
        """Check that this machine sees the folders that scenes are made from.

        Raises:
            UsageError: a folder does not exist here.
        """
        for value in (self.source, self.meshes):
            if value and not value.folder.is_dir():
                raise UsageError(
                    f"A Dask worker does not see {value.folder}; put it into a folder that all machines share."
                )

    def _source_record(self, split: str, index: int) -> SceneRecord | None:
        if self.source is None:
            return None
        scenes = _source_split(self.source, split)
        names = [name for name in scenes.fields(index) if name in FIELDS and FIELDS[name].group in _SIMULATED]
        record = scenes.read(index, names)
        try:
            scene_and_trajectory(record)
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise CorruptFile(
                f"{self.source.folder}, {split} scene {index}: scene/description is damaged ({error}). "
                "Delete the shard and run the command that made it again."
            ) from None
        return record


@functools.lru_cache(maxsize=len(SPLITS))
def _source_split(source: Source, split: str) -> Split:
    """A split, kept open from scene to scene."""
    scenes = Dataset(source.folder).split(split)
    if scenes.settings_hash != source.settings:
        raise UsageError(
            f"{source.folder} was replaced by another dataset while its scenes were rendered; nothing of it was used. "
            "Run the command again."
        )
    return scenes


def check_memory(spec: Spec) -> None:
    """Check that a scene of a dataset fits into memory while it is made.

    Raises:
        UsageError: it would take more than `MOST_MEMORY` bytes.
    """
    needed = scene_memory(spec)
    if needed > MOST_MEMORY:
        raise UsageError(
            f"A scene would take about {needed / 2**30:.1f} GiB of memory, expected at most {MOST_MEMORY / 2**30:.0f} "
            "GiB. Lower --frames, --views, --resolution or --objects.maximum, or leave out --edits and --with."
        )


def scene_memory(spec: Spec) -> int:
    """Bytes that a process holds at most while it makes a scene, measured and rounded up."""
    recipe = recipe_of(spec)
    objects, edits = object_rows(recipe), edits_of(spec)
    width, height = spec["resolution"] or (0, 0)
    # Removals are rendered at three times the resolution, and keep a mask for each object.
    finer, masks = (9, 80 + 2 * objects) if "remove" in edits else (1, 0)
    signals = signals_of(spec)
    maps = 2 * sum(BYTES_PER_SIGNAL_PIXEL.get(name, 0) for name in signals) + 9 * ("tracks" in signals)
    images = recipe.frames * views_of(spec) * width * height * (40 + 20 * len(edits) + masks + maps)
    tables = recipe.frames * (48 * (objects + 1) ** 2 + 72 * views_of(spec) * objects)
    # Objects are counted at a resolution of its own, by a rasteriser that each process keeps.
    judged = max(math.prod(recipe.for_scene(part).visibility_resolution) for part in range(max(1, len(recipe.parts))))
    # Signals keep the surface points of some images.
    return images + (80 * finer + 600 * bool(signals)) * width * height + 80 * judged + tables


def make_scene(
    spec: Spec, split: str, index: int, source: SceneRecord | None = None, meshes: Library | None = None
) -> SceneRecord:
    """All arrays of one scene, a pure function of the spec's settings, the split and the index.

    The scene is simulated unless `source` holds its simulation fields.
    """
    recipe = recipe_of(spec)
    given = cameras_from_values(spec.get("cameras", []))
    # Scene and trajectory, then other cameras if wanted.
    if source:
        record, (scene, trajectory) = source, scene_and_trajectory(source)
    else:
        record, scene, trajectory = _simulate(recipe, spec["seed"], split, index, meshes, given)
    if spec["rig"]:
        cameras = given or sample_cameras(rendered_recipe_of(spec), _rng(spec, split, index, "rig"))
        scene = dataclasses.replace(scene, cameras=cameras)
        record = with_scene(record, scene)
    if not spec["renderer"]:
        return record
    # Images.
    shapes = tuple(build(body.shape, meshes) for body in scene.bodies)
    renderer = _renderer(spec["renderer"]["name"], spec["renderer"].get("samples", SAMPLES))
    width, height = spec["resolution"]
    check_range(scene, shapes, trajectory.world_from_object, (width, height), name=f"{split} scene {index}: ")
    pixels = pixel_record(
        scene,
        shapes,
        trajectory,
        renderer,
        resolution=(width, height),
        rows=object_rows(recipe),
        sensor=recipe.sensor,
        rng=_rng(spec, split, index, "sensor"),
    )
    # Edits and signals, which depend on the images.
    stage = stage_of(scene, shapes, trajectory)
    edits = edits_record(
        stage,
        pixels,
        recipe.for_scene(index),
        renderer,
        {kind: _rng(spec, split, index, kind) for kind in edits_of(spec)},
    )
    signals = signals_record(stage, pixels, signals_of(spec), _rng(spec, split, index, "tracks"))
    if isinstance(renderer, PathTracer):  # last, since labels follow from the rasteriser's colours
        pixels["rgb"] = photographs(scene, shapes, stage.world_from_object, renderer, (width, height))
    return {**record, **pixels, **edits, **signals}


def object_rows(recipe: Recipe) -> int:
    """Length of the object axis: the most objects that a scene can have, at least 1."""
    return max(1, recipe.most_objects)


def _simulate(
    recipe: Recipe, seed: int, split: str, index: int, meshes: Library | None, cameras: tuple[Camera, ...]
) -> tuple[SceneRecord, Scene, Trajectory]:
    # Imported here so that rendering stored scenes does not need the physics engine.
    from datagen.pipeline.simulate import simulate_scene

    made = simulate_scene(recipe, seed, split, index, meshes, cameras)
    tries = {"attempts": made.attempts, "rejections": made.rejections}
    record = simulation_record(made.scene, made.shapes, made.trajectory, rows=object_rows(recipe), **tries)
    return record, made.scene, made.trajectory


def _rng(spec: Spec, split: str, index: int, stream: Stream) -> np.random.Generator:
    return scene_rng(spec["seed"], split, index, stream)


@functools.cache
def _renderer(name: str, samples: int) -> Renderer:
    return make_renderer(name, samples=samples)


def renderer_identity(name: str | None, samples: int | None = None) -> dict[str, str | int] | None:
    """Name and version of a renderer; of a path tracer also its engine and the samples per pixel.

    Raises:
        UsageError: the number of samples is out of range, or the renderer takes none.
    """
    if samples is not None and name != "mitsuba":
        raise UsageError("--samples is for --renderer mitsuba; leave it out, or choose that renderer.")
    if samples is not None and not 1 <= samples <= MOST_SAMPLES:
        raise UsageError(f"--samples is {samples}; expected 1 to {MOST_SAMPLES:,}.")
    if name is None:
        return None
    renderer = _renderer(name, samples or SAMPLES)
    traced = {"engine": renderer.engine, "samples": renderer.samples} if isinstance(renderer, PathTracer) else {}
    return {"name": name, "version": renderer.version, **traced}
