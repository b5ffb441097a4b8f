"""Small groups for quick tests."""

from pathlib import Path

from tests.fuzz.worlds.benchmarks import of_predictions, write_predictions
from tests.fuzz.worlds.datasets import INSPECT, LOAD, STATS, VERIFY
from tests.fuzz.worlds.group import DATASET, Group, Target, run


def build_smoke(world: Path) -> None:
    """A dataset with predictions."""
    run(f"obpose-datagen {DATASET} --split train=1,val=1,test=2 --out {world}/data")
    write_predictions(world)


SMOKE = Group(
    build_smoke,
    [
        Target("data/dataset.json", [STATS, INSPECT, VERIFY], 3),
        Target("data/manifest.json", [VERIFY]),
        Target("data/train-00000.h5", [LOAD, STATS, INSPECT, VERIFY], 4),
        Target("hdf5/labels.h5", of_predictions("hdf5"), 2),
        Target("npz/test/00000.npz", of_predictions("npz"), 2),
        Target("png/test/00001/view0_frame001.png", of_predictions("png"), 1),
    ],
)


def build_text(world: Path) -> None:
    """One file, which nobody reads."""
    world.mkdir()
    (world / "victim.json").write_text("{}")


MISBEHAVIOUR = (
    "raise", "allocate", "sleep", "kill", "leave", "exit", "silent", "internal", "unnamed", "long", "warn", "well",
)  # fmt: skip
MISBEHAVING = Group(
    build_text,
    [Target("victim.json", [f"misbehave {what} {{w}}/victim.json"]) for what in MISBEHAVIOUR],
    is_sound=False,
)
