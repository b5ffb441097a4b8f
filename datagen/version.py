"""The version of the installed package, which `__version__` of all three packages and `--version` state."""

import tomllib
from importlib import metadata
from pathlib import Path

_PYPROJECT = Path(__file__).parent.parent / "pyproject.toml"


def find_version() -> str:
    """Give the version of the installed package; in a checkout that is not installed, that of `pyproject.toml`."""
    try:
        return metadata.version("obpose")
    except metadata.PackageNotFoundError:
        return tomllib.loads(_PYPROJECT.read_text(encoding="utf-8"))["project"]["version"]
