"""The flags of every subcommand of `obpose-datagen`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from datagen.config import Recipe, Rig

_OVERRIDES = tyro.conf.arg(name="")
_FOLDER = Annotated[Path, tyro.conf.Positional]
_Flag = tyro.conf.FlagCreatePairsOff[bool]


@dataclass(frozen=True)
class Constants(Recipe):
    """Every constant of a recipe that the command line can change."""

    name: tyro.conf.Suppress[str] = ""
    description: tyro.conf.Suppress[str] = ""
    resolution: tyro.conf.Suppress[tuple[int, int]] = (128, 128)
    parts: tyro.conf.Suppress[tuple[str, ...]] = ()
    overrides: tyro.conf.Suppress[tuple[str, ...]] = ()

    @classmethod
    def of(cls, recipe: Recipe) -> "Constants":
        """The constants of a recipe."""
        return cls(**vars(recipe))

    def recipe(self) -> Recipe:
        """The recipe with these constants."""
        return Recipe(**vars(self))


@dataclass(frozen=True)
class Generate:
    """Generate a dataset, complete an interrupted one, or extend one; repeat the same command to continue."""

    scenes: int | None = None
    """Number of scenes, 1 to 1,000,000, split 80/10/10 into train, val and test."""
    split: str | None = None
    """Scenes of each split, instead of --scenes, up to 1,000,000 each: train=2000,val=100,test=300."""
    video: _Flag = False
    """Clips of moving objects (recipe `moving`) instead of stills (recipe `static`)."""
    recipe: str | None = None
    """Name of a recipe."""
    out: Path | None = None
    """Folder of the dataset; default data/RECIPE-WxH-seedS."""
    resolution: str | None = None
    """Width x height in pixels, such as 64x64, from 8x8 to 4096x4096; default the recipe's."""
    seed: int = 0
    """Random seed, 0 to 2^63 - 1; scene i of a split depends on the recipe, the seed, the split and i alone."""
    workers: int | None = None
    """Number of processes, at most 64 or four times the number of cores, whichever is more; default one per core."""
    dask: str | None = None
    """Address of a Dask scheduler, tcp://HOST:PORT, whose workers make the scenes; see docs/cluster.md."""
    renderer: Literal["raster", "rich", "pyrender", "mitsuba"] | None = None
    """`raster` (default); `rich` adds reflections and contact shade; `pyrender` uses EGL; `mitsuba` traces paths."""
    samples: int | None = None
    """Paths per pixel of `mitsuba`, 1 to 65,536; default 64."""
    simulate_only: _Flag = False
    """Store scenes and trajectories without images, to be rendered later with `render`."""
    edits: str | None = None
    """Counterfactual edits to render for each scene: one or more of remove,move,add, separated by commas."""
    signals: Annotated[str | None, tyro.conf.arg(name="with")] = None
    """Signals to store with the images: some of flow,tracks,normals,coordinates,amodal, separated by commas."""
    compression: Literal["gzip", "lz4"] = "gzip"
    """Compression of the images; `lz4` is read faster and larger, and needs the extra `lz4`."""
    cameras: Path | None = None
    """JSON file with the intrinsics, size and poses of the cameras, which replace those of --rig and --views."""
    sensor_preset: str | None = None
    """Depth sensor named after a device: kinect-v1, azure-kinect or realsense-d435; it sets the --sensor constants."""
    shard: str | None = None
    """Part i/n of the shards to make, i from 0 to n-1, so that n jobs (at most 100,000) can share the work."""
    overwrite: _Flag = False
    """Replace a dataset of other settings in the same folder."""
    assets: Path | None = None
    """Folder of OBJ, PLY, STL and GLB meshes that objects are drawn from; see docs/meshes.md."""
    unit: Literal["m", "cm", "mm", "in"] | None = None
    """Unit of all meshes; default guessed for each from its size."""
    up: Literal["x", "y", "z"] | None = None
    """Upward axis of all meshes; default y for GLB and z for the others."""
    scale: float = 1.0
    """Further factor on the size of all meshes."""
    assets_split: str | None = None
    """Shares of the meshes that train, val and test draw from, such as 80/10/10; default all splits use all meshes."""
    hull_seconds: float = 300.0
    """CPU time for cutting one mesh into convex hulls, after which its convex hull is used."""
    constants: Annotated[Constants, _OVERRIDES] = Constants()


@dataclass(frozen=True)
class Render:
    """Render images of the scenes of another dataset; needs no physics engine."""

    source: Annotated[Path, tyro.conf.arg(name="from")]
    """The dataset whose scenes are rendered."""
    out: Path | None = None
    """Folder of the new dataset; default data/RECIPE-WxH-seedS."""
    resolution: str | None = None
    """Width x height in pixels, from 8x8 to 4096x4096; default the source's."""
    renderer: Literal["raster", "rich", "pyrender", "mitsuba"] = "raster"
    """`raster` (default); `rich` adds reflections and contact shade; `pyrender` uses EGL; `mitsuba` traces paths."""
    samples: int | None = None
    """Paths per pixel of `mitsuba`, 1 to 65,536; default 64."""
    views: int = 1
    """Cameras, 1 to 360; more than one are spread evenly around the world's z axis."""
    edits: str | None = None
    """Counterfactual edits to render for each scene: one or more of remove,move,add, separated by commas."""
    signals: Annotated[str | None, tyro.conf.arg(name="with")] = None
    """Signals to store with the images: some of flow,tracks,normals,coordinates,amodal, separated by commas."""
    compression: Literal["gzip", "lz4"] | None = None
    """Compression of the images, default that of the source; `lz4` is read faster and larger."""
    workers: int | None = None
    """Number of processes, at most 64 or four times the number of cores, whichever is more; default one per core."""
    dask: str | None = None
    """Address of a Dask scheduler, tcp://HOST:PORT, whose workers make the images; see docs/cluster.md."""
    cameras: Path | None = None
    """JSON file with the intrinsics, size and poses of the cameras, which replace those of --rig and --views."""
    shard: str | None = None
    """Part i/n of the shards to make, i from 0 to n-1, so that n jobs (at most 100,000) can share the work."""
    overwrite: _Flag = False
    """Replace a dataset of other settings in the same folder."""
    assets: Path | None = None
    """Folder of the meshes that the source was made with."""
    rig: Rig = field(default_factory=Rig)


@dataclass(frozen=True)
class Verify:
    """Verify that a dataset's labels, depths, poses and images agree."""

    folder: _FOLDER
    workers: int | None = None
    """Number of processes, at most 64 or four times the number of cores, whichever is more; default one per core."""
    sample: int | None = None
    """Number of scenes to verify, drawn at random, with their files; all if left out."""
    assets: Path | None = None
    """Folder of the meshes that the dataset was made with."""


@dataclass(frozen=True)
class Stats:
    """Print figures about a dataset."""

    folder: _FOLDER


@dataclass(frozen=True)
class Preview:
    """Draw a contact sheet and an animation of a dataset."""

    folder: _FOLDER
    split: Literal["train", "val", "test"] | None = None
    """Split to show; default the first that has scenes."""
    scenes: tuple[int, ...] | None = None
    """Scenes to show; default the first four."""
    out: Path | None = None
    """The picture's file, .png or .jpg; default preview.png in the folder, without --animation."""
    animation: Path | None = None
    """The animation's file, .gif or .mp4; default preview.gif in the folder for clips, without --out."""


@dataclass(frozen=True)
class Inspect:
    """Print the facts of one scene."""

    folder: _FOLDER
    split: Literal["train", "val", "test"] = "train"
    """Split of the scene."""
    scene: int = 0
    """Index of the scene within its split."""


@dataclass(frozen=True)
class Regenerate(Inspect):
    """Generate one scene again and compare all its arrays with the stored ones."""

    assets: Path | None = None
    """Folder of the meshes that the dataset was made with."""


@dataclass(frozen=True)
class Push:
    """Upload a dataset or an export to the Hugging Face hub; log in before with `hf auth login`."""

    folder: _FOLDER
    repository: Annotated[str, tyro.conf.Positional]
    """Name of the dataset on the hub, OWNER/NAME; it is created if necessary."""
    public: _Flag = False
    """Create it for everybody to see; otherwise a new one is private."""
    dry_run: _Flag = False
    """Check the folder and list what would be uploaded, without a network."""


@dataclass(frozen=True)
class Export:
    """Export a dataset to the format of another project; the new folder appears when it is complete."""

    folder: _FOLDER
    format: Literal["webdataset", "movi", "bop", "coco", "obsurf", "obpose", "rgbd"]
    """Name of the format."""
    out: Path
    """New folder for the export."""
    splits: str = "train,val,test"
    """Splits to export, separated by commas; those without scenes are left out."""
    assets: Path | None = None
    """Folder of the meshes that the dataset was made with; only `bop` needs it, for its models."""
    overwrite: _Flag = False
    """Replace an export in the same folder."""


@dataclass(frozen=True)
class Assets:
    """Check a folder of meshes: a table of units, sizes, hulls and problems, and a sheet of thumbnails."""

    action: Annotated[Literal["check"], tyro.conf.Positional]
    """Action on the folder."""
    folder: _FOLDER
    unit: Literal["m", "cm", "mm", "in"] | None = None
    """Unit of all meshes; default guessed for each from its size."""
    up: Literal["x", "y", "z"] | None = None
    """Upward axis of all meshes; default y for GLB and z for the others."""
    scale: float = 1.0
    """Further factor on the size of all meshes."""
    hull_seconds: float = 300.0
    """CPU time for cutting one mesh into convex hulls, after which its convex hull is used."""
    out: Path = Path("assets.png")
    """The sheet of thumbnails, .png or .jpg."""
