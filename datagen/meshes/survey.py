"""Find and examine the meshes of a folder: names, units, defects, and the entries of a dataset."""

import dataclasses
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datagen.config import MESH_PREFIX
from datagen.errors import DatagenError, UsageError
from datagen.meshes.build import Placed, mass_of, place
from datagen.meshes.hulls import Hulls
from datagen.meshes.library import SECONDS, Library, MeshEntry, hulls_of, split_meshes
from datagen.meshes.read import SUFFIXES, RawMesh, read_mesh
from datagen.meshes.units import LARGEST, METRES, SMALLEST, Guess, Unit, Up, guess_unit, guess_up
from datagen.schema import SPLITS

MOST_MESHES = 10_000
"""Largest number of meshes in a folder."""

BEYOND = 0.002
"""Metres that hulls may extend beyond the surface before it is reported."""

_PLAIN_STEMS = {
    "textured",
    "textured_simple",
    "nontextured",
    "model",
    "mesh",
    "object",
    "texture_mesh",
    "model_normalized",
}
_PLAIN_FOLDERS = {"google_16k", "google_64k", "google_512k", "poisson", "tsdf", "clouds", "meshes", "visual", "models"}


@dataclass(frozen=True)
class Reading:
    """How files are read where they do not say it themselves."""

    unit: Unit | None = None
    """Unit of all files; None guesses it for each."""
    up: Up | None = None
    """Upward axis of all files; None takes y for GLB and z for the others."""
    scale: float = 1.0
    """Further factor on all sizes."""
    seconds: float = SECONDS
    """CPU time that the convex decomposition of a mesh may take."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.scale) and 1e-6 <= self.scale <= 1e6):
            raise UsageError(f"--scale {self.scale}: expected a positive number, from 1e-6 to 1e6.")
        if not 1 <= self.seconds <= 86_400:
            raise UsageError(f"--hull-seconds {self.seconds}: expected 1 to 86,400.")


@dataclass(frozen=True, eq=False)
class Examined:
    """One mesh of a folder."""

    name: str
    file: str
    failure: str = ""
    """Why the mesh cannot be used; empty if it can."""
    guess: Guess | None = None
    scale: float = 0.0
    """Metres per unit of the file."""
    up: Up = "z"
    raw: RawMesh | None = None
    placed: Placed | None = None
    hulls: Hulls | None = None

    @property
    def size(self) -> np.ndarray:
        """Extents, metres."""
        return np.ptp(self.placed.surface.vertices, axis=0) if self.placed else np.zeros(3)

    @property
    def warnings(self) -> list[str]:
        """Peculiarities that do not keep the mesh from being used."""
        if self.raw is None or self.placed is None:
            return []
        found, longest = list(self.raw.problems), float(np.max(self.size))
        if longest > LARGEST:
            found.append(f"longest side {100 * longest:.1f} cm, more than {100 * LARGEST:.0f} cm")
        if longest < SMALLEST:
            found.append(f"longest side {1e3 * longest:.2f} mm, less than {1e3 * SMALLEST:.0f} mm")
        if not self.placed.surface.closed:
            found.append("not closed: mass from its hulls, both sides drawn")
        if self.hulls and self.hulls.method == "time limit":
            found.append("convex decomposition took too long: one hull; raise --hull-seconds")
        if self.hulls and self.hulls.method == "failed":
            found.append("convex decomposition failed: one hull")
        if self.hulls and self.hulls.beyond > BEYOND:
            found.append(f"hulls extend {1e3 * self.hulls.beyond:.1f} mm beyond the surface")
        return found


def find_files(folder: Path) -> list[str]:
    """Paths of all mesh files in a folder, sorted; of YCB's resolutions of one object only the coarsest.

    Raises:
        UsageError: there is no such folder, or no mesh in it.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder} is no folder; give one that holds meshes ({', '.join(SUFFIXES)}) with --assets.")
    found = sorted(
        path.relative_to(folder).as_posix()
        for path in folder.rglob("*")
        if path.suffix.lower() in SUFFIXES and path.is_file() and not path.name.startswith(".")
    )
    coarse = {name.split("/google_16k/")[0] for name in found if "/google_16k/" in name}
    found = [name for name in found if _is_wanted(name, coarse)]
    if not found:
        raise UsageError(
            f"{folder} holds no mesh; expected files that end in {', '.join(SUFFIXES)}. Links to folders are not "
            "followed."
        )
    if len(found) > MOST_MESHES:
        raise UsageError(f"{folder} holds {len(found):,} meshes; expected at most {MOST_MESHES:,}. Give a subfolder.")
    return found


def _is_wanted(file: str, coarse: Collection[str]) -> bool:
    """Whether a file is not another version of an object in YCB's `google_16k/textured.obj`."""
    for root in coarse:
        if file.startswith(root + "/"):
            return file == f"{root}/google_16k/textured.obj"
    return True


def name_files(files: Sequence[str]) -> list[str]:
    """A name for each file: its own, or that of its folder where files are all called `textured`."""
    names: list[str] = []
    for file in files:
        path = Path(file)
        stem, parents = path.stem, [part for part in path.parts[:-1] if part.lower() not in _PLAIN_FOLDERS]
        name = parents[-1] if stem.lower() in _PLAIN_STEMS and parents else stem
        name = re.sub(r"[^A-Za-z0-9_.-]+", "_", name) or "mesh"
        number, unique = 2, name
        while unique in names:
            unique, number = f"{name}-{number}", number + 1
        names.append(unique)
    return names


def examine(folder: Path, file: str, name: str, reading: Reading, *, hulls: bool = True) -> Examined:
    """Read one mesh, guess its unit and make its hulls; failures become part of the result."""
    try:
        raw = read_mesh(folder, file)
        suffix = Path(file).suffix.lower()
        longest = float(np.max(np.ptp(raw.vertices[raw.faces].reshape(-1, 3), axis=0)))
        guess = Guess(reading.unit, "--unit") if reading.unit else guess_unit(suffix, longest)
        scale, up = METRES[guess.unit] * reading.scale, reading.up or guess_up(suffix)
        placed = place(raw, scale, up, str(folder / file))
        made = hulls_of(placed, raw.sha256, scale, up, reading.seconds) if hulls else None
        return Examined(name, file, guess=guess, scale=scale, up=up, raw=raw, placed=placed, hulls=made)
    except UsageError:
        raise
    except DatagenError as error:
        return Examined(name, file, failure=str(error))


def fits(wanted: str, name: str) -> bool:
    """Whether a mesh's name is the wanted one, with or without `mesh:`, `ycb_` and the number of a YCB object."""
    return _plain(wanted) == _plain(name)


def _plain(name: str) -> str:
    name = name.removeprefix(MESH_PREFIX).lower().replace("-", "_")
    return name.removeprefix("ycb_")


def make_library(
    folder: Path,
    reading: Reading,
    *,
    categories: Sequence[str] = (),
    shares: tuple[float, float, float] | None = None,
    note: Callable[[str], None] = lambda _name: None,
) -> tuple[Library, list[str]]:
    """The library of a new dataset, and what the user should know about it.

    Args:
        folder: Folder of the meshes.
        reading: How they are read.
        categories: The recipe's `objects.categories`; only meshes named there are used, all if none is named.
        shares: Shares of the meshes in train, val and test; None lets all splits use all.
        note: Called with the name of each mesh before it is examined.

    Raises:
        UsageError: a mesh cannot be used, none is left, or there are too few for the splits.
    """
    wanted = [name for name in categories if name.startswith(MESH_PREFIX)]
    if categories and not wanted:
        raise UsageError(
            f"objects.categories names no mesh; name some of --assets as {MESH_PREFIX}NAME, or use a recipe "
            "without categories, such as moving."
        )
    files = find_files(folder)
    chosen = [
        (file, name)
        for file, name in zip(files, name_files(files), strict=True)
        if not wanted or any(fits(one, name) for one in wanted)
    ]
    absent = [one.removeprefix(MESH_PREFIX) for one in wanted if not any(fits(one, name) for _, name in chosen)]
    if not chosen:
        raise UsageError(f"{folder} holds none of {', '.join(absent):.600}; docs/meshes.md says where to get them.")
    # Quick checks of all files come before the hulls, which take long; only one mesh is kept in memory.
    _check_usable(folder, [_summary(examine(folder, file, name, reading, hulls=False)) for file, name in chosen])
    messages = [f"Not in {folder}: {', '.join(absent)}."] if absent else []
    entries: dict[str, MeshEntry] = {}
    for file, name in chosen:
        note(name)
        one = examine(folder, file, name, reading)
        if not one.raw or not one.hulls:
            raise UsageError(f"{one.failure} The file has changed while it was read.")
        messages += [f"{name}: {warning}." for warning in one.warnings]
        if one.raw.sha256 in entries:
            messages.append(f"{name}: same content as {entries[one.raw.sha256].name}; used once.")
        else:
            entries[one.raw.sha256] = _entry(one)
    splits = split_meshes(list(entries), shares)
    return Library(folder, tuple(dataclasses.replace(x, splits=splits[x.sha256]) for x in entries.values())), messages


def _entry(one: Examined) -> MeshEntry:
    """The entry of a usable mesh, with its mass, for all splits."""
    assert one.raw
    assert one.placed
    assert one.hulls
    mass = mass_of(one.placed.surface, one.hulls.parts)
    x, y, z = mass.center.tolist()
    return MeshEntry(
        name=one.name,
        file=one.file,
        sha256=one.raw.sha256,
        scale=one.scale,
        up=one.up,
        splits=SPLITS,
        hulls=len(one.hulls.parts),
        hulls_method=one.hulls.method,
        hulls_sha256=one.hulls.sha256,
        center=(x, y, z),
        volume=mass.volume,
        inertia=tuple(mass.inertia.ravel().tolist()),
    )


def _summary(one: Examined) -> Examined:
    """The facts about a mesh without its triangles and textures."""
    return dataclasses.replace(one, raw=None, placed=None)


def _check_usable(folder: Path, found: Sequence[Examined]) -> None:
    if failures := [one.failure for one in found if one.failure]:
        more = f" And {len(failures) - 1} more; `assets check` lists them." if len(failures) > 1 else ""
        raise UsageError(f"{failures[0]}{more} Or choose meshes with --objects.categories {MESH_PREFIX}NAME ...")
    if unsure := [one for one in found if one.guess and not one.guess.certain]:
        names = ", ".join(f"{one.file} ({one.guess.reason})" for one in unsure if one.guess)
        raise UsageError(
            f"The unit of {names} cannot be inferred; give it with --unit m, cm, mm or in, and --scale for a further "
            f"factor. `obpose-datagen assets check {folder}` shows the sizes."
        )
