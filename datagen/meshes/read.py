"""Read OBJ, PLY, STL and GLB files into one triangle list with textures; the only module that imports trimesh."""

import base64
import io
import logging
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from datagen.errors import CorruptFile
from datagen.geometry import LINEAR
from datagen.meshes.named_files import BadMesh, NamedFiles, joint_hash, read_file
from datagen.storage.safe_io import MOST_IMAGE_PIXELS, brief_reason, open_embedded_image, parse_json

SUFFIXES = (".obj", ".ply", ".stl", ".glb")
"""File types that can be read, lower case."""

MOST_FACES = 500_000
"""Largest number of triangles of a mesh."""

_MOST_ROWS = 10 * MOST_FACES
"""Largest number of rows of an array in a GLB file."""

FARTHEST = 1e9
"""Largest coordinate of a vertex, in the units of its file."""

_MOST_NAMED = 5
"""Largest number of missing files that are listed."""

_COMPRESSED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression"}
"""glTF extensions that compress triangles."""

_GREY = 0.6
"""Linear grey of parts without a colour of their own."""


@dataclass(frozen=True, eq=False)
class RawMesh:
    """Triangles of a file with all their colours, in the file's units and axes."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    uv: Float[np.ndarray, "face 3 2"]
    """Texture coordinates of each corner; (0, 0) is the upper left corner of the image."""
    colors: Float[np.ndarray, "face 3 3"]
    """Linear RGB of each corner, multiplied with the texture."""
    image: Int[np.ndarray, "face"]
    """Index into `images`, or -1 for faces without a texture."""
    images: tuple[UInt8[np.ndarray, "_ _ 3"], ...]
    """Textures, sRGB."""
    has_colors: bool
    """Whether the file gives textures, vertex colours or material colours."""
    parts: int
    """Number of separate geometries in the file."""
    sha256: str
    """Hash of the content of the file and of all files that it names."""
    problems: tuple[str, ...]
    """Defects that do not make the mesh unusable, such as a missing texture."""


def read_mesh(folder: Path, file: str) -> RawMesh:
    """Read a mesh.

    Args:
        folder: Folder that no named file may lie outside of.
        file: Path of the mesh within the folder.

    Raises:
        BadMesh: the file, or one that it names, is damaged, empty, too large or outside of the folder.
    """
    # Triangles of all parts of the file.
    path = folder / file
    files = NamedFiles(folder, path)
    data = read_file(folder, file)
    _check_face_count(path, data)
    geometries = _load(path, data, files)
    pieces = [_piece(path, geometry, matrix) for geometry, matrix in geometries]
    pieces = [piece for piece in pieces if len(piece.faces)]
    if not pieces and (count := _missing_triangles(path, data)):
        raise BadMesh(f"{path} is truncated: {count:,} of its triangles are missing. Export it again, or remove it.")
    if not pieces:
        raise BadMesh(f"{path} has no triangles; expected a surface. Export it again, or remove it.")
    # One surface, within limits.
    merged = _merge(pieces)
    if len(merged.faces) > MOST_FACES:
        raise _too_many(path, len(merged.faces))
    if not np.all(np.abs(merged.vertices) <= FARTHEST):
        raise BadMesh(
            f"{path} has vertices that are NaN, infinite or beyond {FARTHEST:g}. Export it again, or remove it."
        )
    # Missing files that the mesh names are problems, not errors.
    sha256 = joint_hash(files, data)
    missing = [name for name in dict.fromkeys(files.missing) if name]
    problems = [f"{name:.80} is missing" for name in missing[:_MOST_NAMED]]
    problems += [f"{len(missing) - _MOST_NAMED} more files are missing"] * (len(missing) > _MOST_NAMED)
    return RawMesh(**vars(merged), parts=len(pieces), sha256=sha256, problems=tuple(problems))


@dataclass(frozen=True, eq=False)
class _Piece:
    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    colors: np.ndarray
    image: np.ndarray
    images: tuple[np.ndarray, ...]
    has_colors: bool


def _check_face_count(path: Path, data: bytes) -> None:
    """Refuse meshes with too many faces before they are parsed, which would take minutes."""
    count, suffix = 0, path.suffix.lower()
    if suffix == ".obj":
        count = data.count(b"\nf ") + data.startswith(b"f ")
    elif suffix == ".ply" and (match := re.search(rb"element\s+face\s+(\d{1,18})", data[:65536])):
        count = int(match[1])
    elif suffix == ".stl":
        binary = int.from_bytes(data[80:84], "little")
        count = binary if len(data) == 84 + 50 * binary else data.count(b"endfacet")
    if count > MOST_FACES:
        raise _too_many(path, count)


def _missing_triangles(path: Path, data: bytes) -> int:
    """Number of triangles that a binary STL announces but does not hold."""
    if path.suffix.lower() != ".stl" or len(data) < 84 or b"facet" in data:
        return 0
    return max(0, int.from_bytes(data[80:84], "little") - (len(data) - 84) // 50)


def _too_many(path: Path, count: int) -> BadMesh:
    return BadMesh(
        f"{path} has {count:,} faces; expected at most {MOST_FACES:,}. Simplify it, for example with Blender's "
        "decimate modifier or `trimesh.Trimesh.simplify_quadric_decimation`."
    )


def _load(path: Path, data: bytes, files: NamedFiles) -> list[tuple[Any, np.ndarray]]:
    """All geometries of a file with their transforms."""
    import trimesh

    log = logging.getLogger("trimesh")
    disabled, log.disabled = log.disabled, True
    try:
        if path.suffix.lower() == ".glb":
            _check_glb(path, data)
        with warnings.catch_warnings(action="ignore"):
            loaded: Any = trimesh.load(
                io.BytesIO(data),
                file_type=path.suffix.lower()[1:],
                resolver=files,  # pyright: ignore[reportArgumentType]
                process=False,
                force="scene",
            )
    except BadMesh:
        raise
    except Exception as error:
        # Damaged files make trimesh's parsers fail in any way.
        raise files.failure or BadMesh(
            f"{path} is damaged or no mesh ({brief_reason(error)}). Export it again, or remove it."
        ) from None
    finally:
        log.disabled = disabled
    if files.failure:
        raise files.failure
    found = []
    for node in loaded.graph.nodes_geometry:
        matrix, name = loaded.graph[node]
        if isinstance(geometry := loaded.geometry[name], trimesh.Trimesh):
            found.append((geometry, np.asarray(matrix, np.float64)))
    return found


def _check_glb(path: Path, data: bytes) -> None:
    """Refuse a GLB file with huge arrays, compressed triangles, or images that trimesh silently leaves out."""
    start = 20 + int.from_bytes(data[12:16], "little")
    header = parse_json(data[20:start].decode())
    if compressed := _COMPRESSED & set(header.get("extensionsRequired", [])):
        raise BadMesh(f"{path} needs {min(compressed)}, which is not supported. Export it without compression.")
    if (count := max((each["count"] for each in header.get("accessors", [])), default=0)) > _MOST_ROWS:
        raise BadMesh(f"{path} has an array of {count:,} rows; expected at most {_MOST_ROWS:,}. Simplify the mesh.")
    for number, image in enumerate(header.get("images", [])):
        if "bufferView" in image:
            view = header["bufferViews"][image["bufferView"]]
            first = start + 8 + view.get("byteOffset", 0)
            content = data[first : first + view["byteLength"]]
        elif image["uri"].startswith("data:"):
            content = base64.b64decode(image["uri"].partition(",")[2])
        else:
            continue  # another file, which `NamedFiles` refuses
        try:
            with open_embedded_image(f"{path}: image {number}", io.BytesIO(content)):
                pass
        except CorruptFile as error:
            raise BadMesh(f"{error} Export the mesh again with another texture.") from None


def _piece(path: Path, geometry: Any, matrix: np.ndarray) -> _Piece:
    vertices = np.asarray(geometry.vertices, np.float64)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise BadMesh(f"{path} has vertices without three coordinates. Export it again, or remove it.")
    with np.errstate(all="ignore"):  # numbers that are not finite are refused later
        vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    faces = np.asarray(geometry.faces, np.int64).reshape(-1, 3)
    if np.any((faces < 0) | (faces >= len(vertices))):
        raise BadMesh(f"{path} has faces with corners that do not exist. Export it again, or remove it.")
    if np.linalg.det(matrix[:3, :3]) < 0:
        faces = faces[:, ::-1]
    uv, colors, image = np.zeros((len(faces), 3, 2)), np.full((len(faces), 3, 3), _GREY), None
    visual, has_colors = geometry.visual, False
    if visual.kind == "texture":
        colors[:], image, has_colors = _material(path, visual.material)
        if image is not None and visual.uv is not None and len(visual.uv) == len(vertices):
            uv = np.asarray(visual.uv, np.float64)[faces] * [1, -1] + [0, 1]
        else:
            image = None
    elif visual.kind == "vertex":
        colors, has_colors = LINEAR[np.asarray(visual.vertex_colors)[:, :3]][faces], True
    elif visual.kind == "face":
        colors, has_colors = np.repeat(LINEAR[np.asarray(visual.face_colors)[:, None, :3]], 3, axis=1), True
    images = () if image is None else (image,)
    index = np.full(len(faces), -1 if image is None else 0)
    if not np.all(np.isfinite(uv)):
        raise BadMesh(f"{path} has texture coordinates that are NaN. Export it again, or remove it.")
    return _Piece(vertices, faces, uv, colors, index, images, has_colors)


def _material(path: Path, material: Any) -> tuple[np.ndarray, np.ndarray | None, bool]:
    """Linear RGB factor, texture, and whether the file gives any colour."""
    picture = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if hasattr(material, "baseColorFactor"):
        factor = material.baseColorFactor  # linear, by the glTF specification
        color = np.ones(3) if factor is None else np.asarray(factor, np.float64)[:3] / 255
        return color, picture and _pixels(path, picture), True
    # To meshes with texture coordinates and no material, trimesh gives one with an image of 2x2 pixels, whose property
    # `name` is never empty.
    given = bool(material.kwargs) or "_name" in vars(material)
    if picture and (given or picture.size != (2, 2)):
        # Exporters write any Kd beside map_Kd; viewers show the texture alone.
        return np.ones(3), _pixels(path, picture), True
    return LINEAR[np.asarray(material.diffuse)[:3]], None, given


def _pixels(path: Path, picture: Any) -> np.ndarray:
    width, height = picture.size
    if width * height > MOST_IMAGE_PIXELS:
        raise BadMesh(
            f"{path} has a texture of {width} x {height} pixels; expected at most {MOST_IMAGE_PIXELS:,} in all. "
            "Make it smaller."
        )
    try:
        return np.asarray(picture.convert("RGB"))
    except Exception as error:
        raise BadMesh(f"{path} has a damaged texture ({brief_reason(error)}). Export it again.") from None


def _merge(pieces: list[_Piece]) -> _Piece:
    images: list[np.ndarray] = []
    rows, start, faces = [], 0, []
    for piece in pieces:
        rows.append(np.where(piece.image < 0, -1, piece.image + len(images)))
        images.extend(piece.images)
        faces.append(piece.faces + start)
        start += len(piece.vertices)
    return _Piece(
        vertices=np.concatenate([piece.vertices for piece in pieces]),
        faces=np.concatenate(faces),
        uv=np.concatenate([piece.uv for piece in pieces]),
        colors=np.concatenate([piece.colors for piece in pieces]),
        image=np.concatenate(rows),
        images=tuple(images),
        has_colors=any(piece.has_colors for piece in pieces),
    )
