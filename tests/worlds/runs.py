"""A small run folder with models of every kind, made from a truth that is spoilt in known ways."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark import report
from benchmark.models.interface import Prediction
from benchmark.ranking.standings import load_standings
from benchmark.results.labels import write_labels
from benchmark.results.run_folder import Measured, RunKey, RunRow, save_row
from benchmark.results.scoring import score_labels
from datagen.storage.reader import Dataset
from datagen.tracks import find_dataset
from tests.worlds.traced import write_dataset

TRACKS = {"moving": {"frames": 5, "views": 1}, "static": {"frames": 1, "views": 3}}

Spoil = Callable[[np.ndarray, np.random.Generator], np.ndarray]


@dataclass(frozen=True)
class Model:
    """How a fabricated model errs, and what its rows say."""

    spoil: Spoil
    kind: str
    random: bool = False
    tuned: bool = False
    uses_labels: bool = False


def _merge(truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.where(truth == 2, 1, truth)


def _split(truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    left = np.arange(truth.shape[-1]) < truth.shape[-1] // 2
    return np.where((truth == 1) & left, 7, truth)


def _noise(truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    strength = rng.uniform(0.05, 0.4)
    return np.where(rng.random(truth.shape) < strength, rng.integers(0, 5, truth.shape), truth)


def _swap_in_time(truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    swapped = truth.copy()
    swapped[len(truth) // 2 :] = np.where(truth > 0, 4 - truth, 0)[len(truth) // 2 :]
    return swapped


MODELS: dict[str, Model] = {
    "noisy-learner": Model(_noise, "learned", random=True),
    "merger": Model(_merge, "classical", tuned=True),
    "splitter": Model(_split, "classical"),
    "one-cluster": Model(lambda truth, rng: np.zeros_like(truth), "floor"),
    "switching-oracle": Model(_swap_in_time, "oracle", uses_labels=True),
}


def write_runs(
    folder: Path, *, scenes: int = 6, seeds: int = 2, models: Mapping[str, Model] = MODELS, crash: str | None = None
) -> dict[str, Path]:
    """Fill `folder/run`, and give the dataset of each track; the model `crash` fails on every track."""
    data = {}
    for track, sizes in TRACKS.items():
        data[track] = write_dataset(folder / track, scenes=scenes, size=(48, 36), spheres=3, **sizes)
        for model in models:
            for seed in range(seeds):
                _write_run(folder / "run", data[track], track, model, models[model], seed, crashed=model == crash)
    return data


def write_report(run: Path, data: Mapping[str, Path], **options: int) -> None:
    """Write the page of a run folder, where tracks have these datasets."""
    report.write(
        run,
        load_standings(run),
        lambda track, spec_hash: find_dataset(track, spec_hash, [data[track]] if track in data else []),
        command="obpose-bench --model <b>",
        date="2026-01-02",
        **options,
    )


def _write_run(run: Path, dataset: Path, track: str, name: str, model: Model, seed: int, *, crashed: bool) -> None:
    spec = json.loads((dataset / "dataset.json").read_text())["spec_hash"]
    key = RunKey(
        track=track,
        model=name,
        fit_track=track,
        seed=seed,
        version=1,
        config_hash="0" * 64,
        fit_spec=spec,
        track_spec=spec,
    )
    split = Dataset(dataset).split("test")
    if not crashed:
        _write_labels(run, dataset, key, model)
    steps = [{"step": 10.0 * i, "loss": 2.0 / (i + 1 + seed), "msc_fg": 1 - 1 / (i + 2)} for i in range(8)]
    save_row(
        run,
        RunRow(
            key=key,
            status="failed" if crashed else "ok",
            reason="out of memory" if crashed else "",
            config={},
            tuned=model.tuned,
            uses_labels=model.uses_labels,
            kind=model.kind,  # type: ignore[arg-type]
            priors=("slots",),
            random=model.random,
            n_scenes=0 if crashed else len(split),
            parameters=1000 if model.kind == "learned" else 0,
            device="cpu",
            commit="0123456789abcdef",
            measured=Measured(0.001 * (1 + 7 * sorted(MODELS).index(name) if name in MODELS else 1), 1.0, 100.0),
            learning_curve=steps if model.kind == "learned" else None,
        ),
    )


def _write_labels(run: Path, dataset: Path, key: RunKey, model: Model) -> None:
    split = Dataset(dataset).split("test")
    path = run / "labels" / f"{key.name}.h5"
    with write_labels(path, len(split), dataset) as writer:
        for scene in range(len(split)):
            truth = split.read(scene, ["segmentation"])["segmentation"].astype(np.int64)
            rng = np.random.default_rng([scene, key.seed if model.random else 0])
            writer.put(scene, Prediction(model.spoil(truth, rng), background_slot=0))
    score_labels(path, split, run, key.name)
