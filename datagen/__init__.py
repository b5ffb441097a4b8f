"""Synthetic RGB-D scenes of objects on a table, with exact labels."""

import os
from pathlib import Path


def _choose_kernels() -> None:
    """Have NumPy's BLAS compute alike on all x86-64 CPUs, which works where NumPy was not imported before.

    OpenBLAS picks kernels by CPU type, which round differently; collisions make millimetres of the last bits. These
    kernels need AVX2. Whatever the variable was set to before would give scenes that nobody else gets.
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
