"""Files that a mesh consists of: itself, and the MTL files and textures that it names.

They are read only from inside the folder that the user gave, and all of them count for the mesh's content hash.
"""

import hashlib
import os
import re
from dataclasses import dataclass, field
from pathlib import Path

from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.storage.safe_io import open_image, read_bytes

MOST_BYTES = 2**28
"""Largest size of a mesh file or texture, bytes."""

_MOST_HEADER = 65536
"""Largest part of a PLY file in which its header is searched, bytes."""

_IMAGES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".tga", ".gif")


class BadMesh(CorruptFile):
    """A mesh that cannot be used; the message names the file and the remedy."""


def content_hash(folder: Path, file: str) -> str:
    """Hash of the content of a mesh file and of the MTL files and textures that it names.

    Raises:
        BadMesh: as `read_mesh`.
    """
    return joint_hash(NamedFiles(folder, folder / file), read_file(folder, file))


def joint_hash(files: "NamedFiles", data: bytes) -> str:
    """Hash of a mesh file's content, given in `data`, and of the files that it names."""
    contents = [data]
    if files.mesh.suffix.lower() == ".obj":
        materials = [content for name in _names(data, rb"mtllib") if (content := files.find(name)) is not None]
        textures = [name for material in materials for name in _names(material, rb"map_Kd")]
        contents += [*materials, *(content for name in textures if (content := files.find(name)) is not None)]
    elif files.mesh.suffix.lower() == ".ply":
        textures = _names(data[:_MOST_HEADER], rb"comment TextureFile")
        contents += [content for name in textures if (content := files.find(name)) is not None]
    digests = [hashlib.sha256(content).hexdigest() for content in contents]
    # A mesh without further files has the hash of its file.
    return digests[0] if len(digests) == 1 else hashlib.sha256("\n".join(digests).encode()).hexdigest()


@dataclass
class NamedFiles:
    """Resolver for trimesh: reads files that a mesh names, from inside one folder only."""

    folder: Path
    mesh: Path
    missing: list[str] = field(default_factory=list)
    failure: DatagenError | None = None
    """First error that makes the mesh unusable; trimesh swallows exceptions of resolvers."""

    def find(self, name: str) -> bytes | None:
        """Content of a named file; None if there is none.

        Raises:
            BadMesh: the file lies outside of the folder.
            DatagenError: it is too large, or a damaged image.
        """
        name = name.strip().replace("\\", "/")
        try:
            path = Path(os.path.realpath(self.mesh.parent / name))  # `resolve` fails on a link to itself
            is_there = path.is_file()
        except (OSError, ValueError):  # a name that is too long, or has a null character
            self.missing.append(name)
            return None
        if not path.is_relative_to(self.folder.resolve()):
            raise BadMesh(
                f"{self.mesh} names {name!r:.80}, which lies outside of {self.folder}; nothing was read. "
                "Put the file beside the mesh and name it without a folder."
            )
        if self.mesh.suffix.lower() not in (".obj", ".ply"):
            raise BadMesh(f"{self.mesh} names the file {name!r:.80}; expected one file with all data embedded.")
        if not is_there:
            self.missing.append(name)
            return None
        if path.suffix.lower() in _IMAGES:
            with open_image(path, ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "TGA", "GIF")):
                pass
        return read_bytes(path, MOST_BYTES)

    def get(self, name: str) -> bytes:
        """Read a named file for trimesh.

        Raises:
            FileNotFoundError: there is none, or it may not be read.
        """
        try:
            data = self.find(name)
        except DatagenError as error:
            self.failure = self.failure or error
            raise FileNotFoundError(name) from None
        if data is None:
            raise FileNotFoundError(name)
        return data

    # Names that trimesh expects of a resolver.
    __getitem__ = get

    def keys(self) -> list[str]:
        """Names known in advance: none."""
        return []

    def namespaced(self, _namespace: str) -> "NamedFiles":
        """Give this reader itself: there is one namespace, while some formats have several."""
        return self


def read_file(folder: Path, file: str) -> bytes:
    """Content of a mesh file.

    Raises:
        BadMesh: it is empty, or lies outside of the folder.
        UsageError: there is no such file.
    """
    path = folder / file
    if not path.resolve().is_relative_to(folder.resolve()):
        raise BadMesh(f"{path} lies outside of {folder}; nothing was read. Copy it into the folder.")
    try:
        data = read_bytes(path, MOST_BYTES)
    except FileNotFoundError:
        raise UsageError(f"{path} does not exist; give the folder that holds the mesh with --assets.") from None
    if not data:
        raise BadMesh(f"{path} is empty. Export it again, or remove it.")
    return data


def _names(data: bytes, keyword: bytes) -> list[str]:
    """Arguments of all lines of an OBJ or MTL file that begin with a keyword, each once, in their order."""
    found = re.findall(rb"^[ \t]*" + keyword + rb"[ \t]+([^\r\n]+)", data, re.MULTILINE | re.IGNORECASE)
    return list(dict.fromkeys(name.decode("utf-8", "replace").strip() for name in found))
