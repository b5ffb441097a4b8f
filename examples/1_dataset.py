"""Make a small dataset and look into it.

python examples/1_dataset.py DIR
"""

import sys
from pathlib import Path

from datagen.config import load_recipe
from datagen.pipeline.generate import generate
from datagen.storage.reader import Dataset


def main(folder: Path) -> None:
    """Generate ten clips of moving objects and print what scene 0 holds."""
    generate(folder, load_recipe("moving"), splits={"train": 6, "val": 2, "test": 2}, resolution=(64, 64))

    scenes = Dataset(folder).split("train")
    record = scenes[0]  # a dict of NumPy arrays; docs/dataset.md explains every field
    print(f"{len(scenes)} training scenes; rgb of scene 0: {record['rgb'].shape} [frame, view, height, width, channel]")

    depth = record["depth"] * 1e-4  # metres
    print(f"Depth from {depth[depth > 0].min():.2f} to {depth.max():.2f} m")

    for row in range(record["objects/count"]):
        name = record["objects/category"][row].decode()
        first, last = record["poses/position"][[0, -1], row]  # metres, world frame
        pixels = (record["segmentation"][0] == row + 1).sum()  # label 0 is the background
        print(f"Object {row + 1}, {name}: {pixels} pixels in frame 0, moves from {first.round(2)} to {last.round(2)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
