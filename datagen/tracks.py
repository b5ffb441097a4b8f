"""Tracks: benchmark datasets of fixed recipe, sizes and seed, generated on first use.

path = find_track("moving").prepare(("val", "test"))    # makes what is missing in the cache folder
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

from datagen.config import Recipe, load_recipe, names_without_meshes
from datagen.console.progress import Progress, no_progress
from datagen.console.text import counted
from datagen.errors import DatagenError, UsageError, unknown_name
from datagen.rgbd import OBJECTS
from datagen.schema import EditKind
from datagen.storage.atomic import cache_folder
from datagen.storage.portable_names import check_dataset_name
from datagen.storage.reader import Dataset
from datagen.storage.spec import recipe_of

SIZES = {"train": 2000, "val": 100, "test": 300}
"""Scenes of each split."""
SEED = 0
DEFAULT = "moving"
"""Track that is used if none is named."""
Profile = Literal["cpu", "gpu"]
"""Size of images and of the networks that learn from them: for a CPU core, or for a GPU."""
PROFILES: tuple[Profile, ...] = get_args(Profile)
SQUARE: dict[Profile, tuple[int, int]] = {"cpu": (64, 64), "gpu": (128, 128)}
WIDE: dict[Profile, tuple[int, int]] = {"cpu": (80, 60), "gpu": (128, 96)}
"""Width and height of the images; used for recipes whose images are not square."""
REAL_TABLE = "real-table"
"""Track whose data are the user's: see `RealTable`."""
REAL_TABLES = (REAL_TABLE, f"{REAL_TABLE}-predicted")
"""Names of that track: with true masks, and with masks that are predictions of another model."""
GROUPS = {"paper": ("moving", "static", "clevr3d", "multishape")}
"""Names that stand for several tracks; `paper` holds the tracks for which the paper has tables."""


@dataclass(frozen=True)
class Track:
    """Benchmark dataset: a recipe at fixed sizes."""

    name: str
    """Name of the track and of its recipe."""
    profile: Profile = "cpu"
    edits: tuple[EditKind, ...] = ()
    """Counterfactual edits to include. A track with edits has a separate dataset with equal scenes."""

    @property
    def resolution(self) -> tuple[int, int]:
        """Width and height of its images."""
        width, height = load_recipe(self.name).resolution
        return (SQUARE if width == height else WIDE)[self.profile]

    @property
    def description(self) -> str:
        """Description of the track, from its recipe."""
        return load_recipe(self.name).description

    @property
    def slots(self) -> int:
        """Slots that every model may use: its largest object count, plus one for the background."""
        recipe = load_recipe(self.name)
        return _slots(recipe)

    @cached_property
    def spec_hash(self) -> str:
        """Identity of the dataset, which need not exist."""
        from datagen.pipeline.generate import dataset_spec

        return dataset_spec(load_recipe(self.name), **self._sizes())["spec_hash"]

    @property
    def folder(self) -> Path:
        """Folder of the dataset, whether or not it exists; each version of the recipe has its own."""
        width, height = self.resolution
        return cache_folder() / "tracks" / f"{self.name}-{width}x{height}-{self.spec_hash[:8]}"

    def size(self, split: str) -> int:
        """Scenes of a split, made or not."""
        return SIZES[split]

    def labels_shape(self, split: str) -> tuple[int, int, int, int, int]:
        """Shape of the label maps of a split: scenes, frames, views, height, width."""
        recipe, (width, height) = load_recipe(self.name), self.resolution
        return self.size(split), recipe.frames, recipe.views, height, width

    def missing(self, splits: Iterable[str]) -> int:
        """Number of scenes of these splits still to be generated."""
        if not (self.folder / "dataset.json").exists():
            return sum(map(self.size, splits))
        return DataFolder(self.folder).missing(splits)

    def prepare(self, splits: Iterable[str], *, workers: int = 1, progress: Progress = no_progress) -> Path:
        """Generate the missing scenes of these splits, and return the folder.

        Raises:
            DatagenError: scenes could not be generated; another call resumes.
        """
        names = tuple(splits)
        if self.missing(names):
            from datagen.pipeline.generate import Run, generate

            run = Run(workers=workers, splits=names, progress=progress)
            generate(self.folder, load_recipe(self.name), run=run, **self._sizes())
        return self.folder

    def _sizes(self) -> dict[str, Any]:
        sizes = {split: self.size(split) for split in SIZES}
        return {"splits": sizes, "seed": SEED, "resolution": self.resolution, "edits": self.edits}


@dataclass(frozen=True)
class DataFolder:
    """Dataset given by the user, in place of a track."""

    folder: Path

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name

    @property
    def resolution(self) -> tuple[int, int]:
        """Width and height of its images."""
        width, height = Dataset(self.folder).spec["resolution"]
        return width, height

    @property
    def slots(self) -> int:
        """Slots that every model may use: its recipe's largest object count, plus one for the background."""
        spec = Dataset(self.folder).spec
        return _slots(recipe_of(spec)) if spec["recipe"]["parts"] else 1 + spec["recipe"]["objects"]["maximum"]

    @cached_property
    def spec_hash(self) -> str:
        """Identity of the dataset."""
        return Dataset(self.folder).spec["spec_hash"]

    def size(self, split: str) -> int:
        """Scenes of a split, made or not."""
        return Dataset(self.folder).splits[split]

    def labels_shape(self, split: str) -> tuple[int, int, int, int, int]:
        """Shape of the label maps of a split: scenes, frames, views, height, width."""
        return Dataset(self.folder).split(split).labels_shape

    def missing(self, splits: Iterable[str]) -> int:
        """Number of scenes of these splits that are missing."""
        dataset = Dataset(self.folder)
        return sum(len(dataset.split(name).missing()) for name in splits)

    def prepare(self, splits: Iterable[str], *, workers: int = 1, progress: Progress = no_progress) -> Path:
        """Check that these splits are complete, and return the folder.

        Raises:
            DatagenError: scenes are missing.
        """
        names = tuple(splits)
        if missing := self.missing(names):
            raise DatagenError(
                f"{self.folder} is incomplete: {counted(missing, 'scene')} missing ({', '.join(names)}). "
                "Run the command that began it again to complete it."
            )
        return self.folder


@dataclass(frozen=True)
class RealTable(DataFolder):
    """Frames of tables, given by the user, in which models segment what stands on the table."""

    @property
    def name(self) -> str:
        """Name of the track; masks that are predictions of another model have a track of their own."""
        origin = Dataset(self.folder).spec.get("import") or {}
        return REAL_TABLES[bool(origin.get("predicted_masks"))]

    @property
    def slots(self) -> int:
        """Slots that every model may use, whatever the masks show."""
        return 1 + OBJECTS


Source = Track | DataFolder
"""Dataset to fit or score on."""


def find_data_folder(folder: Path, kind: type[DataFolder] = DataFolder) -> DataFolder:
    """Load the dataset of images in a folder, as a source of this kind.

    Raises:
        UsageError: the folder holds no dataset or none with images, or has a name that cannot be part of file names.
        CorruptFile: its `dataset.json` is damaged.
    """
    if Dataset(folder).spec["resolution"] is None:
        raise UsageError(f"{folder} holds no images; make them with: obpose-datagen render --from {folder}.")
    found = kind(folder)
    check_dataset_name(found.name)
    return found


def find_track(name: str, profile: Profile = "cpu") -> Track:
    """Find the track of that name.

    Raises:
        UsageError: there is none; the message suggests the nearest name.
    """
    names = names_without_meshes()
    if name in names:
        return Track(name, profile)
    if name == REAL_TABLE:
        raise UsageError(f"Track {name!r} is of your own frames: name a dataset that holds them with --data.")
    if name in GROUPS:
        raise UsageError(f"{name!r} is a group of tracks; expected one of its members: {', '.join(GROUPS[name])}.")
    raise unknown_name("track", name, [*names, *GROUPS])


def find_tracks(names: Iterable[str], profile: Profile = "cpu") -> list[Track]:
    """Find the tracks of these names, without duplicates; groups are replaced by their members.

    Raises:
        UsageError: as `find_track`.
    """
    members = [member for name in names for member in GROUPS.get(name, (name,))]
    return [find_track(name, profile) for name in dict.fromkeys(members)]


def all_tracks(profile: Profile = "cpu") -> list[Track]:
    """List all tracks, one for each recipe."""
    return [Track(name, profile) for name in names_without_meshes()]


def find_dataset(track: str, spec_hash: str, folders: Iterable[Path]) -> Path | None:
    """Find the dataset of that identity in one of the folders or among the tracks already made; None if absent."""
    made = [Track(track, profile).folder for profile in PROFILES] if track in names_without_meshes() else []
    for folder in (*folders, *made):
        if (folder / "dataset.json").exists() and Dataset(folder).spec["spec_hash"] == spec_hash:
            return folder
    return None


def _slots(recipe: Recipe) -> int:
    return 1 + recipe.most_objects
