"""Small mesh files of all kinds, written by tests."""

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

BOX = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
"""Corners of a cube of side 2."""

QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
"""Outward sides of `BOX`: -x, +x, -y, +y, -z, +z."""

SIDES = ((200, 30, 30), (30, 200, 30), (30, 30, 200), (200, 200, 30), (30, 200, 200), (200, 30, 200))
"""sRGB of the texture of each side."""


def triangles() -> np.ndarray:
    """Faces of `BOX`."""
    return np.array([face for a, b, c, d in QUADS for face in ((a, b, c), (a, c, d))])


def write_obj(folder: Path, *, texture: str = "box.png") -> Path:
    """A box of 10 x 8 x 12 cm with six coloured sides in one texture: `folder/box.obj`, its MTL file and image."""
    folder.mkdir(parents=True, exist_ok=True)
    pixels = np.repeat(np.repeat(np.array(SIDES, np.uint8).reshape(2, 3, 3), 32, axis=0), 32, axis=1)
    Image.fromarray(pixels).save(folder / "box.png")
    (folder / "box.mtl").write_text(f"newmtl paint\nKd 0 0 0\nmap_Kd {texture}\n")
    lines = ["mtllib box.mtl", "usemtl paint"]
    lines += ["v {:.6f} {:.6f} {:.6f}".format(*corner) for corner in BOX * [0.05, 0.04, 0.06]]
    for side in range(6):
        # Away from the borders of the side's field in the texture; v counts from the lower edge.
        left, top = side % 3 / 3 + 0.05, 1 - (side // 3 / 2 + 0.05)
        lines += [f"vt {u:.4f} {v:.4f}" for u in (left, left + 0.23) for v in (top, top - 0.4)]
    for side, (a, b, c, d) in enumerate(QUADS):
        u = 4 * side
        lines.append(f"f {a + 1}/{u + 1} {b + 1}/{u + 2} {c + 1}/{u + 4} {d + 1}/{u + 3}")
    path = folder / "box.obj"
    path.write_text("\n".join(lines) + "\n")
    return path


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray | None = None) -> Path:
    """An ASCII PLY file, perhaps with vertex colours."""
    path.parent.mkdir(parents=True, exist_ok=True)
    head = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    head += [f"property float {axis}" for axis in "xyz"]
    if colors is not None:
        head += [f"property uchar {name}" for name in ("red", "green", "blue")]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(map(str, row)) for row in vertices.tolist()]
    if colors is not None:
        rows = [f"{row} {r} {g} {b}" for row, (r, g, b) in zip(rows, colors.tolist(), strict=True)]
    path.write_text("\n".join([*head, *rows, *(f"3 {a} {b} {c}" for a, b, c in faces.tolist())]) + "\n")
    return path


def write_textured_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    """A PLY file as BOP's: texture coordinates at the vertices, and an image that a comment names."""
    write_ply(path, vertices, faces)
    Image.new("RGB", (4, 4), (250, 120, 10)).save(path.with_suffix(".png"))
    text = path.read_text().replace("format ascii 1.0", f"format ascii 1.0\ncomment TextureFile {path.stem}.png")
    text = text.replace("property float z", "property float z\nproperty float texture_u\nproperty float texture_v")
    head, body = text.split("end_header\n")
    rows = body.splitlines()
    rows[: len(vertices)] = [f"{row} 0.5 0.5" for row in rows[: len(vertices)]]
    path.write_text(head + "end_header\n" + "\n".join(rows) + "\n")
    return path


def write_textured_glb(path: Path) -> Path:
    """A GLB file of a cube with a PNG image inside."""
    path.parent.mkdir(parents=True, exist_ok=True)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=Image.new("RGB", (4, 4), (250, 120, 10)))
    visual = trimesh.visual.TextureVisuals(uv=np.full((8, 2), 0.5), material=material)
    trimesh.Trimesh(0.05 * BOX, triangles(), visual=visual, process=False).export(path)
    return path


def write_stl(path: Path, corners: np.ndarray) -> Path:
    """A binary STL file of triangles (face corner axis)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    record = np.zeros(len(corners), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    record["corners"] = corners
    path.write_bytes(bytes(80) + len(corners).to_bytes(4, "little") + record.tobytes())
    return path
