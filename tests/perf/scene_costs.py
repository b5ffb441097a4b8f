"""CPU time to make one scene of each recipe: python -m tests.perf.scene_costs moving static cluttered.

NUMBA_CACHE_DIR=$(mktemp -d) python -m tests.perf.scene_costs moving    compiles the renderer in the first scene
"""

import statistics
import sys
import time

from datagen.config import load_recipe
from datagen.pipeline.generate import dataset_spec
from datagen.pipeline.make_scene import SceneMaker

SCENES = 20


def scene_seconds(name: str) -> tuple[float, list[float]]:
    """CPU seconds of the first scene of a recipe, compilation included, and of each of the first scenes without it."""
    recipe = load_recipe(name)
    make = SceneMaker(dataset_spec(recipe, splits={"train": SCENES}, seed=0, resolution=recipe.resolution))

    def seconds(index: int) -> float:
        started = time.process_time()
        make("train", index)
        return time.process_time() - started

    return seconds(0), [seconds(index) for index in range(SCENES)]


if __name__ == "__main__":
    for recipe_name in sys.argv[1:]:
        first, others = scene_seconds(recipe_name)
        print(f"{recipe_name:12} {1e3 * statistics.mean(others):6.1f} ms a scene; the first one {first:.1f} s")
