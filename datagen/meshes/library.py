"""Meshes of a dataset: where they are, what identifies them, and the shapes that they become."""

import dataclasses
import functools
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datagen.errors import CorruptFile, UsageError
from datagen.meshes.build import Placed, make_shape, place
from datagen.meshes.hulls import Hulls, find_hulls
from datagen.meshes.named_files import content_hash
from datagen.meshes.read import read_mesh
from datagen.meshes.units import Up
from datagen.scene import ShapeSpec
from datagen.schema import SPLITS
from datagen.shapes.geometry.mass import Mass, of_mesh
from datagen.shapes.shape import Shape
from datagen.storage.structure import strict_converter, structure

FAMILY = "mesh"
"""Shape family of meshes."""

SECONDS = 300.0
"""CPU time that CoACD may take for one mesh."""

_ROUNDING = 1e-6
"""Relative difference of masses that rounding may cause."""

_CACHED = 32


@dataclass(frozen=True)
class MeshEntry:
    """One mesh of a dataset, as `dataset.json` stores it."""

    name: str
    """Category of objects with this mesh."""
    file: str
    """Path within the folder of meshes."""
    sha256: str
    """Hash of the content of the file and of the files that it names."""
    scale: float
    """Metres per unit of the file."""
    up: Up
    """Axis of the file that becomes z."""
    splits: tuple[str, ...]
    """Splits whose scenes may hold it."""
    hulls: int
    """Number of convex hulls."""
    hulls_method: str
    """Method by which the hulls were made, see `datagen.meshes.hulls.Hulls.method`."""
    hulls_sha256: str
    """Hash of the hulls; other hulls would move differently."""
    center: tuple[float, float, float]
    """Centre of mass, metres, in the axes of the object."""
    volume: float
    """Volume, cubic metres."""
    inertia: tuple[float, ...]
    """Inertia about the centre of mass at density 1, m^5, row by row."""

    @property
    def spec(self) -> ShapeSpec:
        """The shape in a scene's description."""
        return ShapeSpec(FAMILY, {"file": self.file, "sha256": self.sha256, "scale": self.scale, "up": self.up})

    @property
    def mass(self) -> Mass:
        """Mass of density 1."""
        return Mass(self.volume, np.array(self.center), np.array(self.inertia).reshape(3, 3))


@dataclass(frozen=True)
class Library:
    """All meshes of a dataset, in a folder of the user."""

    folder: Path
    entries: tuple[MeshEntry, ...]
    hulls: bool = True
    """Whether shapes get convex hulls, which only simulation and edits need."""

    def shape(self, parameters: Mapping[str, Any]) -> Shape:
        """The shape that a scene's description names.

        Raises:
            UsageError: the dataset has no such mesh, or its file has changed.
        """
        for entry in self.entries:
            if entry.spec.parameters == parameters:
                return _shape(self.folder, entry, self.hulls)
        raise UsageError(f"A scene names the mesh {dict(parameters)!s:.200}, which its dataset does not list.")

    def names(self, split: str) -> list[str]:
        """Names of the meshes that scenes of a split may hold."""
        return [entry.name for entry in self.entries if split in entry.splits]

    def entry(self, name: str) -> MeshEntry:
        """The mesh of a name."""
        return next(entry for entry in self.entries if entry.name == name)

    def check(self) -> None:
        """Check that all files are those of the dataset.

        Raises:
            UsageError: names the first file that is missing or has another content.
        """
        for entry in self.entries:
            if not (self.folder / entry.file).is_file():
                raise UsageError(
                    f"{self.folder / entry.file} is missing; the dataset was made with it. "
                    "Give the folder that holds it with --assets."
                )
            _check_content(self.folder, entry, content_hash(self.folder, entry.file))

    def faults(self) -> list[str]:
        """Meshes whose stored mass is not that of their closed surface; hulls of open ones cannot be checked."""
        found = []
        for entry in self.entries:
            name = str(self.folder / entry.file)
            surface = place(read_mesh(self.folder, entry.file), entry.scale, entry.up, name).surface
            if surface.closed:
                mass = of_mesh(surface.vertices, surface.faces)
                wrong = [
                    abs(mass.volume / entry.volume - 1),
                    *np.abs(mass.center - entry.center) / entry.volume ** (1 / 3),
                ]
                if max(wrong) > _ROUNDING:
                    found.append(f"{entry.file}: volume or centre of mass in dataset.json is not that of its surface")
        return found

    def values(self) -> list[dict[str, Any]]:
        """Plain values for `dataset.json`."""
        return [dataclasses.asdict(entry) for entry in self.entries]

    def without_hulls(self) -> "Library":
        """Copy without convex hulls, for rendering and verification: they need no CoACD."""
        return dataclasses.replace(self, hulls=False)


def open_library(values: Sequence[Mapping[str, Any]] | None, folder: Path | None) -> Library | None:
    """The meshes that a dataset's spec lists, in a folder; None if it lists none.

    Raises:
        UsageError: the dataset needs a folder and there is none, or a file is missing or has changed.
        CorruptFile: the list is damaged.
    """
    if not values:
        if folder is not None:
            raise UsageError("The dataset was made without meshes; leave out --assets.")
        return None
    if folder is None:
        raise UsageError("The dataset was made with meshes; give the folder that holds them with --assets.")
    try:
        entries = tuple(structure(dict(value), MeshEntry, strict_converter(), "assets") for value in values)
    except (ValueError, TypeError) as error:
        raise CorruptFile(f"The dataset's list of meshes is damaged ({error}); restore dataset.json.") from None
    library = Library(folder, entries)
    library.check()
    return library


def _check_content(folder: Path, entry: MeshEntry, sha256: str) -> None:
    if sha256 != entry.sha256:
        raise UsageError(
            f"{folder / entry.file} is not the file that the dataset was made with: SHA-256 {sha256[:12]}..., expected "
            f"{entry.sha256[:12]}... (textures count too). Restore the original."
        )


@functools.lru_cache(maxsize=_CACHED)
def _shape(folder: Path, entry: MeshEntry, hulls: bool) -> Shape:
    raw = read_mesh(folder, entry.file)
    _check_content(folder, entry, raw.sha256)
    placed = place(raw, entry.scale, entry.up, str(folder / entry.file))
    parts: tuple[np.ndarray, ...] = ()
    if hulls:
        # Where the time limit was met, another attempt with more time would give other hulls.
        seconds = 1.0 if entry.hulls_method == "time limit" else SECONDS
        found = hulls_of(placed, entry.sha256, entry.scale, entry.up, seconds)
        if found.sha256 != entry.hulls_sha256:
            raise UsageError(
                f"The convex hulls of {entry.file} differ from those that the dataset was made with, perhaps because "
                f"of another version of CoACD or another time limit. Use the original version, or generate the "
                "dataset again in a new folder."
            )
        parts = found.parts
    return make_shape(placed, entry.mass, parts)


def hulls_of(placed: Placed, sha256: str, scale: float, up: Up, seconds: float = SECONDS) -> Hulls:
    """Hulls of a placed mesh in metres, from the cache or computed."""
    surface = placed.surface
    key = f"{sha256[:32]}-{scale:g}-{up}"
    return find_hulls(key, surface.vertices, surface.faces, closed=surface.closed, seconds=seconds)


def split_meshes(hashes: Sequence[str], shares: tuple[float, float, float] | None) -> dict[str, tuple[str, ...]]:
    """Splits of each mesh: all of them without shares, otherwise one, by the order of the content hashes.

    Every split with a share gets at least one mesh.

    Raises:
        UsageError: there are fewer meshes than splits with a share.
    """
    if shares is None:
        return dict.fromkeys(hashes, SPLITS)
    # Hashes are hashed again, so that the order has nothing to do with any other use of them.
    order = sorted(set(hashes), key=lambda value: hashlib.sha256(f"split {value}".encode()).hexdigest())
    used = [row for row, share in enumerate(shares) if share > 0]
    if len(order) < len(used):
        raise UsageError(
            f"--assets-split needs at least {len(used)} different meshes, one for each split with a share; "
            f"there are {len(order)}."
        )
    exact = np.array(shares) / sum(shares) * len(order)
    counts = np.floor(exact).astype(int)
    counts[used] = np.maximum(counts[used], 1)
    while counts.sum() > len(order):
        counts[np.argmax(np.where(counts > 1, counts - exact, -np.inf))] -= 1
    while counts.sum() < len(order):
        counts[np.argmax(exact - counts)] += 1
    names = np.repeat(np.array(SPLITS), counts)
    return {value: (str(name),) for value, name in zip(order, names, strict=True)}
