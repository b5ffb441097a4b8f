"""Run folders, edits and predictions of the benchmark."""

import shutil
from pathlib import Path

import h5py
import numpy as np
from PIL import Image

import assets
from datagen.storage.reader import Dataset
from tests.fuzz.worlds.group import DATASET, MODEL, Group, Target, run


def build_benchmarks(world: Path) -> None:
    """A run folder with rows of all kinds, edits, and predictions in all layouts."""
    run(f"obpose-datagen {DATASET} --split train=1,val=1,test=2 --out {world}/data")
    for command in (RUN, RUN_LEARNED, SCORE_EDITS):
        run(command.format(w=world))
    (trained,) = (world / "results/runs").glob("*--obpose-loc--*.json")
    shutil.copytree(world / "results", world / "unfinished")
    (world / "unfinished/runs" / trained.name).unlink()
    write_predictions(world)


def write_predictions(world: Path) -> None:
    """The truth as label maps, with a pose for every label."""
    maps = [record["segmentation"] for record in Dataset(world / "data").split("test")]
    count = int(max(labels.max() for labels in maps)) + 1
    center = np.zeros((*maps[0].shape[:2], count, 3))
    rotation = np.broadcast_to(np.eye(3), (*center.shape, 3))
    poses = {"center": center, "rotation": rotation, "size": np.full(center.shape, 0.1)}
    (world / "npz/test").mkdir(parents=True)
    for scene, labels in enumerate(maps):
        np.savez(world / f"npz/test/{scene:05d}.npz", labels=labels, background_slot=0, **poses)
        (folder := world / f"png/test/{scene:05d}").mkdir(parents=True)
        for frame, image in enumerate(labels[:, 0]):
            Image.fromarray(image).save(folder / f"view0_frame{frame:03d}.png")
    (world / "hdf5").mkdir()
    with h5py.File(world / "hdf5/labels.h5", "w") as file:
        file["labels"], file["background_slots"] = np.stack(maps), np.zeros(len(maps), np.uint8)
        places = np.argwhere(np.ones((len(maps), *center.shape[:3])))
        file["poses/index"] = places
        for name, values in poses.items():
            file[f"poses/{name}"] = np.stack([values] * len(maps))[tuple(places.T)]


_BENCH = "obpose-bench --data {w}/data --workers 1 --seeds 1"
RUN = f"{_BENCH} --model one-cluster plane-components --out {{w}}/results"
RUN_LEARNED = f"{_BENCH} --model obpose-loc --steps 1 --out {{w}}/results"
GO_ON = f"{_BENCH} --model obpose-loc --steps 1 --out {{w}}/unfinished"
COMPARE = "obpose-bench compare one-cluster plane-components --run {w}/results"
REPORT = "obpose-bench report {w}/results --data {w}/data"
RESCORE = "obpose-bench rescore {w}/results --data {w}/data"
SCORE_EDITS = (
    f"obpose-bench --task editing --checkpoint {assets.CHECKPOINTS / MODEL} --name own --data {{w}}/data --scenes 1"
    " --workers 1 --out {w}/edits"
)
PREDICTIONS = "obpose-bench --predictions {w}/LAYOUT --data {w}/data --workers 1 --out {o}"


def of_predictions(layout: str) -> list[str]:
    """Commands that score predictions in one of the layouts."""
    return [PREDICTIONS.replace("LAYOUT", layout), f"{PREDICTIONS} --background-slot 0".replace("LAYOUT", layout)]


BENCHMARKS = Group(
    build_benchmarks,
    [
        Target("hdf5/labels.h5", of_predictions("hdf5"), 20),
        Target("npz/test/00000.npz", of_predictions("npz"), 16),
        Target("png/test/00001/view0_frame001.png", of_predictions("png"), 8),
        Target("results/runs/data--one-cluster--0--*.json", [COMPARE, REPORT, RUN, RESCORE], 12),
        Target("results/scenes/data--plane-components--0--*.csv", [COMPARE, REPORT, RUN], 8),
        Target("results/labels/data--plane-components--0--*.h5", [RESCORE, RESCORE, REPORT], 14),
        Target("results/reconstructions/data--obpose-loc--0--*/00000.webp", [REPORT, RUN], 8),
        Target("results/manifest.json", [REPORT, RUN], 4),
        Target("results/curves/data--obpose-loc--0--*.csv", [REPORT, COMPARE], 6),
        Target("unfinished/training/*/training.safetensors", [GO_ON], 3),
        Target("unfinished/watched/*.csv", [GO_ON], 4),
        Target("edits/editing/data--own--*.csv", [SCORE_EDITS], 6),
    ],
)
