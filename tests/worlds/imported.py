"""Small imported datasets: stills of two balls on a table, with or without masks."""

from pathlib import Path

from datagen.formats.import_request import Request
from datagen.formats.importers.write import import_dataset
from datagen.storage.reader import Dataset
from tests.worlds.recordings import CAMERAS, shoot, write_rgbd


def import_balls(folder: Path, *, masks: tuple[str, ...] = ("train", "val", "test"), frames: int = 1) -> Dataset:
    """Import a scene for each split, of which those in `masks` have masks."""
    for place, split in enumerate(("train", "val", "test")):
        shot = shoot(CAMERAS[place])
        write_rgbd(folder / "source" / split / "0", [shot] * frames, masks=split in masks)
    import_dataset(Request(format="rgbd", source=folder / "source", out=folder / "balls"))
    return Dataset(folder / "balls")
