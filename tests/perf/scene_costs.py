"""CPU time to make one scene of each recipe: python -m tests.perf.scene_costs moving static cluttered."""

import statistics
import sys
import time

from datagen.config import load_recipe
from datagen.pipeline.generate import dataset_spec
from datagen.pipeline.make_scene import SceneMaker

SCENES = 20


def scene_seconds(name: str) -> list[float]:
    """CPU seconds of each of the first scenes of a recipe, compilation aside."""
    recipe = load_recipe(name)
    make = SceneMaker(dataset_spec(recipe, splits={"train": SCENES}, seed=0, resolution=recipe.resolution))
    make("train", 0)

    def seconds(index: int) -> float:
        started = time.process_time()
        make("train", index)
        return time.process_time() - started

    return [seconds(index) for index in range(SCENES)]


if __name__ == "__main__":
    for recipe_name in sys.argv[1:]:
        print(f"{recipe_name:12} {1e3 * statistics.mean(scene_seconds(recipe_name)):6.1f} ms a scene")
