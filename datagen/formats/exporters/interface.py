"""Interface of the exporters: one function that writes scenes, and the facts that cards and checks need."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from datagen.formats.scenes import ExportScene
from datagen.inspect.croissant import Files

__all__ = ["CAMERAS", "PIXELS", "Exporter", "Files"]

PIXELS = ("rgb", "depth", "segmentation")
CAMERAS = ("camera/K", "camera/world_from_camera")


@dataclass(frozen=True)
class Exporter:
    """Writer of one format."""

    title: str
    """Name of the format."""
    write: Callable[[Path, Iterable[ExportScene]], None]
    """Function that writes scenes, split by split and in order, to an empty folder."""
    needs: tuple[str, ...]
    """Fields that a dataset must have."""
    files: dict[str, Files]
    """Kinds of files by name."""
    loading: str
    """Python code that reads the export; `{folder}` stands for its path, `{split}` for a split with scenes."""
    layout: str
    """Description of the files, Markdown."""
    loses: str
    """Description of the fields and precision that the format cannot hold, Markdown."""
    hub_config: Callable[[Iterable[str]], str] = lambda _splits: ""
    """Function from the splits to further lines of the card's header, such as how the hub loads the files."""
