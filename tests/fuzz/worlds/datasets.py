"""Datasets."""

from pathlib import Path

from tests.fuzz.worlds.group import DATASET, MODEL, TINY, Group, Target, run


def build_datasets(world: Path) -> None:
    """A dataset with images, a sensor and edits."""
    run(f"obpose-datagen {DATASET} --split train=2,val=1,test=1 --out {world}/data")


LOAD = "load {w}/data"
VERIFY = "obpose-datagen verify {w}/data --workers 1"
STATS = "obpose-datagen stats {w}/data"
PREVIEW = "obpose-datagen preview {w}/data --out {o}.png --animation {o}.gif"
INSPECT = "obpose-datagen inspect {w}/data"
REGENERATE = "obpose-datagen regenerate {w}/data"
RESUME = f"obpose-datagen {DATASET} --split train=2,val=1,test=1 --out {{w}}/data"
RENDER = "obpose-datagen render --from {w}/data --resolution 8x8 --workers 1 --out {o}"
TRAIN = f"obpose-train --variant obpose --data {{w}}/data --steps 1 --out {{o}} {TINY}"
SCORE = "obpose-bench --model one-cluster --data {w}/data --workers 1 --seeds 1 --out {o}"
INFER = f"obpose-edit infer --checkpoint {MODEL} --data {{w}}/data --refine 0 --resolution 8x8 --out {{o}}"
VIEW = f"obpose-view {{w}}/data --checkpoint {MODEL}"

DATASETS = Group(
    build_datasets,
    [
        Target(
            "data/dataset.json",
            [LOAD, VERIFY, STATS, PREVIEW, INSPECT, REGENERATE, RESUME, RENDER, TRAIN, SCORE, INFER, VIEW],
            30,
        ),
        Target("data/manifest.json", [VERIFY, RESUME, STATS], 6),
        Target("data/train-00000.h5", [LOAD, VERIFY, STATS, PREVIEW, INSPECT, REGENERATE, RESUME, RENDER, TRAIN], 40),
        Target("data/val-00000.h5", [LOAD, VERIFY, RESUME, RENDER, TRAIN], 10),
        Target("data/test-00000.h5", [LOAD, VERIFY, SCORE, INFER, VIEW], 20),
    ],
)
