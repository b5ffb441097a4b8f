"""Shared by all tests: shape checks on every module, and small datasets made once a session."""

from pathlib import Path

from jaxtyping import install_import_hook

ROOT = Path(__file__).parent.parent
UNCHECKED = {"datagen.render.kernels"}
"""Modules whose functions numba compiles; it cannot compile the checker's wrappers."""


def _leaf_modules() -> list[str]:
    files = (path for package in ("datagen", "obpose", "benchmark") for path in (ROOT / package).rglob("*.py"))
    names = {".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files if path.stem != "__init__"}
    return sorted(names - UNCHECKED)


install_import_hook(_leaf_modules(), "beartype.beartype")
