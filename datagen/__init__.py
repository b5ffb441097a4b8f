"""Synthetic RGB-D scenes of objects on a table, with exact labels."""

import os
from pathlib import Path


def _choose_kernels() -> None:
    """Select the same OpenBLAS kernels on all x86-64 CPUs; has no effect if NumPy was imported before.

    OpenBLAS picks kernels by CPU type, which round differently, and collisions amplify the last bits to millimetres.
    The selected kernels need AVX2. A previous value of the variable is replaced: it would give other scenes.
    """
    try:
        flags = Path("/proc/cpuinfo").read_text()
    except OSError:
        return
    if " avx2 " in flags:
        os.environ["OPENBLAS_CORETYPE"] = "Haswell"


_choose_kernels()


def __getattr__(name: str) -> str:
    """Give `__version__`, which takes longer to find than the rest of this package to import."""
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from datagen.version import find_version

    return find_version()
