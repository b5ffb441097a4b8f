"""Make datasets in parallel, shard by shard; interrupted runs resume."""

import dataclasses
import json
import time
from collections.abc import Collection, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from datagen.config import MESH_PREFIX, Recipe, recipe_to_dict
from datagen.console.progress import Progress, no_progress
from datagen.errors import UsageError
from datagen.inspect.dataset_card import write_card
from datagen.meshes.library import Library, open_library
from datagen.pipeline.make_scene import SceneMaker, Source, check_memory, make_scene, renderer_identity
from datagen.pipeline.shards import make_here, make_on_cluster, shard_tasks, write_shard
from datagen.schema import DATA_VERSION, SPLITS, EditKind, Signal, array_hash
from datagen.storage.atomic import resolve_output
from datagen.storage.cameras_file import CamerasFile
from datagen.storage.dataset_folder import filling, settle, write_file
from datagen.storage.manifest import delete_records, is_finished, make_manifest, recorded_facts
from datagen.storage.reader import Dataset
from datagen.storage.spec import MANIFEST_FILE, Compression, Spec, compression_of, make_spec, settings_hash


@dataclass(frozen=True)
class Run:
    """Options of a run that do not change the content of the dataset."""

    workers: int = 1
    """Number of processes."""
    dask: str | None = None
    """Address of the scheduler of a Dask cluster that makes the scenes, instead of processes of this machine."""
    share: tuple[int, int] = (0, 1)
    """Share (i, n) of the work: make only the shards whose number modulo n is i."""
    splits: tuple[str, ...] = SPLITS
    """Splits whose shards are made; the others can follow in another run."""
    overwrite: bool = False
    """Whether to replace a dataset of other settings in the same folder."""
    progress: Progress = no_progress
    """Progress display."""


@dataclass(frozen=True)
class Report:
    """Result of a run."""

    spec: Spec
    """Spec of the dataset after the run."""
    scenes_made: int
    complete: bool
    """Whether every scene of the spec exists."""
    seconds: float


def generate(
    folder: Path,
    recipe: Recipe,
    *,
    splits: Mapping[str, int],
    seed: int = 0,
    resolution: tuple[int, int] | None = None,
    renderer: str | None = "raster",
    samples: int | None = None,
    edits: Collection[EditKind] = (),
    meshes: Library | None = None,
    signals: Collection[Signal] = (),
    cameras: CamerasFile | None = None,
    compression: Compression = "gzip",
    run: Run = Run(),
) -> Report:
    """Make a dataset, complete it, or extend it.

    Args:
        folder: Folder of the dataset, new or not.
        recipe: Content of the dataset.
        splits: Scenes of each split.
        seed: Any non-negative integer.
        resolution: Width and height of the images, the recipe's if None.
        renderer: Name of the renderer; None stores scenes and trajectories without images.
        samples: Paths per pixel of the renderer `mitsuba`.
        edits: Counterfactual edits that are rendered beside each scene.
        meshes: Meshes that objects are drawn from, instead of the recipe's categories.
        signals: Optional signals that are stored beside the images.
        cameras: Cameras that replace the recipe's.
        compression: Compression of the images; `lz4` needs hdf5plugin.
        run: Options that do not change the content.

    Raises:
        UsageError: the request contradicts itself or what is in the folder.
        DatagenError: it could not be completed; running it again goes on.
    """
    settings = {
        "splits": splits,
        "seed": seed,
        "resolution": resolution,
        "renderer": renderer,
        "samples": samples,
        "cameras": cameras,
        "compression": compression,
    }
    spec = dataset_spec(recipe, **settings, edits=edits, signals=signals, meshes=meshes)
    return _fill(folder, spec, None, meshes, run)


def dataset_spec(
    recipe: Recipe,
    *,
    splits: Mapping[str, int],
    seed: int = 0,
    resolution: tuple[int, int] | None = None,
    renderer: str | None = "raster",
    samples: int | None = None,
    edits: Collection[EditKind] = (),
    meshes: Library | None = None,
    signals: Collection[Signal] = (),
    cameras: CamerasFile | None = None,
    compression: Compression = "gzip",
) -> Spec:
    """The spec of the dataset that `generate` makes of these arguments in a new folder.

    Raises:
        UsageError: no scenes are requested; edits, signals or lz4 are requested without images; or the recipe needs
            meshes and there are none.
    """
    # Combinations that make no dataset.
    if not any(splits.values()):
        raise UsageError("A dataset needs scenes, and no scenes are requested; request at least one in a split.")
    if not meshes and (named := [name for name in recipe.objects.categories if name.startswith(MESH_PREFIX)]):
        raise UsageError(
            f"Recipe {recipe.name!r} needs meshes such as {named[0].removeprefix(MESH_PREFIX)}; give the folder that "
            "holds them with --assets. docs/meshes.md says where to download the YCB objects."
        )
    if signals and not renderer:
        raise UsageError("Signals belong to images, and a dataset without images has none; leave one of them out.")
    if edits and not renderer:
        raise UsageError("Edits are pictures, and a dataset without images has none; leave one of them out.")
    if compression != "gzip" and not renderer:
        raise UsageError(
            f"Compression {compression} is for images, and a dataset without images has none; leave it out."
        )
    built_in = any(not name.startswith(MESH_PREFIX) for name in recipe.objects.categories)
    if (
        meshes
        and not built_in
        and (bare := [name for name, scenes in splits.items() if scenes and not meshes.names(name)])
    ):
        raise UsageError(
            f"Split {bare[0]} has scenes, but no mesh; give it a share in --assets-split, or make no scenes for it."
        )
    # Given cameras decide the number of views, and the size unless one is given.
    if cameras:
        cameras.check_frames(recipe.frames)
        recipe = dataclasses.replace(recipe, views=len(cameras.views))
        resolution = resolution or cameras.resolution
    return make_spec(
        recipe_to_dict(recipe),
        seed=seed,
        splits=splits,
        resolution=(resolution or recipe.resolution) if renderer else None,
        cameras=cameras.views if cameras else (),
        renderer=renderer_identity(renderer, samples),
        edits=edits,
        assets=meshes.values() if meshes else (),
        signals=signals,
        compression=compression,
    )


def render(
    source: Path,
    folder: Path,
    *,
    resolution: tuple[int, int] | None = None,
    renderer: str = "raster",
    samples: int | None = None,
    rig: Recipe | None = None,
    edits: Collection[EditKind] = (),
    assets: Path | None = None,
    signals: Collection[Signal] = (),
    cameras: CamerasFile | None = None,
    compression: Compression | None = None,
    run: Run = Run(),
) -> Report:
    """Make images of the scenes of another dataset, which may have images; needs no physics engine.

    The source's or its recipe's resolution is used if None, and the source's compression. The cameras (`rig`, `views`)
    of the recipe `rig` replace the source's. `assets` is the folder of the source's meshes. The other arguments are
    those of `generate`.

    Raises:
        UsageError: the source is no dataset, of another data version or the folder itself, or the request contradicts
            what is in the folder; or the folder is a link that leads to itself.
        DatagenError: the source is incomplete, or the run could not be completed.
    """
    # Refuse datasets that cannot be rendered.
    dataset = Dataset(source)
    if resolve_output(folder) == source.resolve():
        raise UsageError(f"{folder} is the dataset whose scenes are to be rendered; give another folder with --out.")
    if dataset.spec["data_version"] != DATA_VERSION:
        raise UsageError(
            f"{source} was made by data version {dataset.spec['data_version']}, this program makes version "
            f"{DATA_VERSION}; render it with the program that made it, or generate it again."
        )
    dataset.check_complete()
    settings = {
        "resolution": resolution,
        "renderer": renderer,
        "samples": samples,
        "rig": rig,
        "edits": edits,
        "signals": signals,
        "compression": compression,
    }
    spec = render_spec(dataset.spec, **settings, cameras=cameras)
    meshes = open_library(dataset.spec.get("assets"), assets)
    # Rendering needs no hulls, and so no CoACD; placing edited objects does.
    if meshes and not edits:
        meshes = meshes.without_hulls()
    return _fill(folder, spec, Source(source, settings_hash(dataset.spec)), meshes, run)


def render_spec(
    source: Spec,
    *,
    resolution: tuple[int, int] | None = None,
    renderer: str = "raster",
    samples: int | None = None,
    rig: Recipe | None = None,
    edits: Collection[EditKind] = (),
    signals: Collection[Signal] = (),
    cameras: CamerasFile | None = None,
    compression: Compression | None = None,
) -> Spec:
    """The spec of a dataset that `render` makes of the scenes of another."""
    # Cameras: those of a file, of a recipe, or of the source.
    poses = cameras.views if cameras else () if rig else source.get("cameras", ())
    replaced = {key: recipe_to_dict(rig)[key] for key in ("rig", "views")} if rig else source["rig"]
    if cameras:
        cameras.check_frames(source["recipe"]["frames"])
        replaced = {"rig": (source["rig"] or source["recipe"])["rig"], "views": len(cameras.views)}
        resolution = resolution or cameras.resolution
    width, height = resolution or source["resolution"] or source["recipe"]["resolution"]
    return make_spec(
        source["recipe"],
        seed=source["seed"],
        splits=source["splits"],
        resolution=(width, height),
        renderer=renderer_identity(renderer, samples),
        rig=replaced,
        cameras=poses,
        edits=edits,
        assets=source.get("assets") or (),
        signals=signals,
        compression=compression or compression_of(source),
    )


def regenerate(folder: Path, split: str, index: int, assets: Path | None = None) -> list[str]:
    """Generate one scene again and compare it with the stored one; returns the names of the arrays that differ.

    `assets` is the folder of the dataset's meshes.

    Raises:
        UsageError: the folder holds no dataset, or no such scene, or its meshes have changed.
        DatagenError: the scene has not been made yet, or cannot be read.
    """
    dataset = Dataset(folder)
    stored = dataset.split(split)[index]
    fresh = make_scene(dataset.spec, split, index, meshes=open_library(dataset.spec.get("assets"), assets))
    return [
        name for name in stored if name not in fresh or array_hash(name, stored[name]) != array_hash(name, fresh[name])
    ]


def _fill(folder: Path, wanted: Spec, source: Source | None, meshes: Library | None, run: Run) -> Report:
    started = time.monotonic()
    check_memory(wanted)

    def make_first() -> None:
        """Generate and discard one scene, so that an infeasible recipe fails before any file is touched."""
        if split := next((name for name, scenes in wanted["splits"].items() if scenes), None):
            SceneMaker(wanted, source, meshes)(split, 0)

    # Make the missing scenes of each shard, and write shards as they become complete.
    with filling(folder, wanted, overwrite=run.overwrite, prove=make_first) as spec:
        tasks = shard_tasks(folder, spec, run.splits, run.share)
        scenes = sum(len(task.todo) for task in tasks)
        maker = SceneMaker(spec, source, meshes)
        with (run.progress if tasks else no_progress)(scenes) as advance:
            if run.dask is not None and tasks:
                shards = make_on_cluster(maker, tasks, run.dask, folder, advance)
            else:
                shards = make_here(maker, tasks, run.workers, advance)
            with closing(shards):
                for task, new in shards:
                    if new is not None:
                        write_shard(folder, spec, task, new)
        # Parallel runs may have requested other numbers of scenes.
        spec = settle(folder, spec)
        finished = not tasks and is_finished(folder, spec)
        facts = None if finished else recorded_facts(folder, spec)
        seconds = time.monotonic() - started
        # The run that completes the dataset describes it.
        if facts:
            write_card(folder)
            manifest = make_manifest(spec, facts, seconds=seconds, workers=run.workers, scenes_made=scenes)
            write_file(folder, MANIFEST_FILE, (json.dumps(manifest, indent=2) + "\n").encode(), settings_hash(spec))
            delete_records(folder)
    return Report(spec, scenes, finished or facts is not None, seconds)
