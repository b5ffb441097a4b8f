"""Turn the flags of `obpose-bench` into a request, and into limits of its jobs; check the numbers."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from benchmark.commands import arguments
from benchmark.execution.executor import Limits, Runnable, limits
from benchmark.execution.on_cluster import on_cluster
from benchmark.execution.plan import Request, Weights
from benchmark.models.adapters.predictions import PredictionFolder
from benchmark.models.interface import LARGEST_LABEL, slots_for_objects
from benchmark.models.registry import budget_of, discover, expand, find_model, row_names
from benchmark.names import check_model_name, find_twin
from benchmark.ranking.text import plain_number
from datagen.errors import UsageError
from datagen.storage.reader import Dataset
from datagen.tracks import (
    DEFAULT,
    REAL_TABLE,
    REAL_TABLES,
    DataFolder,
    RealTable,
    Source,
    find_data_folder,
    find_track,
    find_tracks,
)
from obpose.storage.pretrained import find_checkpoint
from obpose.systems import system_of

LIMITS: dict[str, tuple[float, float]] = {
    "seeds": (1, 1000),
    "workers": (1, 256),
    "steps": (1, 10**9),
    "scenes": (1, 10**6),
    "refine": (0, 100_000),
    "slots": (1, LARGEST_LABEL),
    "background-slot": (0, LARGEST_LABEL),
    "budget": (0.001, 31 * 24 * 3600),
    "time-limit": (0.001, 31 * 24 * 60),
    "memory-limit": (1, 2**30),
}
"""Smallest and largest value by the name of the flag, in the flag's unit."""


def check_flag(flag: str, value: float | None) -> None:
    """Check the value of a flag; None stands for a flag that was left out.

    Raises:
        UsageError: the value is out of range; states the range.
    """
    low, high = LIMITS[flag]
    if value is not None and not low <= value <= high:  # also nan
        shown = str(value) if isinstance(value, int) else plain_number(value)
        raise UsageError(f"--{flag} is {shown:.40}; expected {plain_number(low)} to {plain_number(high)}.")


FITTED_ON = "desk"
"""Track on which models for real tables are fitted and tuned: never on the real frames."""
_OF_MODELS = ("slots", "pretrained", "fit_track", "budget", "steps")
"""Flags that do not apply to --predictions."""


def request_of(values: arguments.Run) -> Request:
    """Build the request that the flags describe.

    Raises:
        UsageError: flags contradict each other, or name something that does not exist.
    """
    _check(values)
    names = values.track or (values.fit_track or DEFAULT,)
    sources: list[Source] = [*find_tracks(names, values.profile)] if values.data is None else [_scored_folder(values)]
    fit_track = values.fit_track or (FITTED_ON if isinstance(sources[0], RealTable) else None)
    if values.predictions and values.task == "editing":
        raise UsageError("--task editing is for models; label maps cannot be edited.")
    if values.predictions:
        return _predictions_request(values, sources)
    models = _models(values, sources[0])
    learns = any(find_model(name).kind == "learned" for name in models)
    if values.deterministic and values.steps is None and learns and not values.pretrained:
        raise UsageError("--deterministic counts budgets in steps; say how many with --steps.")
    if values.pretrained and not learns:
        raise UsageError("--pretrained is for models that learn; name one, or leave it out.")
    if (values.pretrained or values.checkpoint) and values.slots:
        raise UsageError("--slots is for models that are made here: weights have the slots of their training.")
    return Request(
        models=models,
        sources=tuple(sources),
        seeds=values.seeds,
        fit_source=find_track(fit_track, values.profile) if fit_track else None,
        seconds=values.budget if values.budget is not None else budget_of(values.model),
        steps=values.steps,
        pretrained=values.pretrained,
        weights=_weights(values),
        slots=tuple(dict.fromkeys(map(slots_for_objects, values.slots))),
        profile=values.profile,
    )


def job_limits(values: arguments.Run, seconds: float) -> Limits:
    """Limits of each job, with a time limit of `seconds` unless a flag sets another."""
    return limits(
        60 * values.time_limit if values.time_limit else seconds,
        workers=values.workers,
        memory_mib=values.memory_limit or (math.inf if values.dask is not None else None),
        threads=1 if values.deterministic or values.dask is not None else None,
    )


@contextmanager
def places(values: arguments.Run, jobs: Sequence[Runnable]) -> Iterator[int]:
    """Choose where `run_jobs` runs jobs, and yield how many it may start at a time; a cluster queues them itself."""
    if values.dask is None or not jobs:
        yield values.workers
        return
    with on_cluster(values.dask, values.out):
        yield len(jobs)


def _check(values: arguments.Run) -> None:
    places = bool(values.track) + (values.data is not None and values.track != (REAL_TABLE,))
    models = bool(values.model or values.checkpoint)
    if models == bool(values.predictions) or places > 1 or (values.predictions and not places):
        raise UsageError(
            "Name what to score and where: --model NAME [NAME ...], --checkpoint DIR or --predictions DIR, and --track "
            f"NAME [NAME ...] or --data DIR (models are scored on the track {DEFAULT!r} if left out); --list shows "
            "models and tracks."
        )
    given = [flag for flag in _OF_MODELS if getattr(values, flag) not in ((), False, None)]
    if values.predictions and given:
        flag = given[0].replace("_", "-")
        raise UsageError(f"--{flag} is for models that are run here; --predictions are scored as they are.")
    if values.name is not None and not values.predictions and len(values.checkpoint) != 1:
        raise UsageError("--name is for --predictions or one --checkpoint; models go by their own names.")
    if values.scenes is not None and values.task != "editing":
        raise UsageError("--scenes is for --task editing; segmentations are scored on all test scenes.")
    if values.task == "editing" and REAL_TABLE in values.track:
        raise UsageError(f"--track {REAL_TABLE} is for segmentations; for --task editing, leave it out.")
    if values.refine and values.task != "editing":
        raise UsageError("--refine is for --task editing; segmentations are scored as they are inferred.")
    if values.background_slot is not None and not values.predictions:
        raise UsageError("--background-slot is for --predictions; models declare their background themselves.")
    for flag in LIMITS:
        given = getattr(values, flag.replace("-", "_"))
        for number in given if isinstance(given, tuple) else (given,):
            check_flag(flag, number)
    if values.out.exists() and not values.out.is_dir():
        raise UsageError(f"{values.out} is a file; give a folder with --out.")
    if (values.out / "dataset.json").exists():
        raise UsageError(f"{values.out} is a dataset, whose manifest would be lost; give another folder with --out.")


def _scored_folder(values: arguments.Run) -> DataFolder:
    assert values.data is not None
    folder = values.data
    source = find_data_folder(folder, RealTable if values.track else DataFolder)
    if not values.track and source.name in REAL_TABLES:
        raise UsageError(f"{folder} has the name of a track; add --track {REAL_TABLE}, or rename the folder.")
    dataset = Dataset(folder)
    if not source.size("test"):
        raise UsageError(f"{folder} has no test scenes to score on; {_test_scenes_advice(dataset)}")
    if "segmentation" not in dataset.fields("test"):
        raise UsageError(
            f"{folder} has no masks in its test split, so that nothing can be scored. Import it again with masks; "
            "models can be trained on it with obpose-train."
        )
    return source


def _test_scenes_advice(dataset: Dataset) -> str:
    if not dataset.imported:
        return "generate some with --scenes or --split test=N."
    return (
        "import it again, with more recordings, with --frames N or --group stills, which make several scenes of a "
        "recording, or with --split test. Models that are tuned on split val can use --fit-track instead."
    )


def _models(values: arguments.Run, source: Source) -> tuple[str, ...]:
    """List the models to score. Groups lose their oracles on real tables, whose models never get the ground truth."""
    models = expand(values.model)
    if not isinstance(source, RealTable):
        return tuple(models)
    oracles = [name for name in models if find_model(name).kind == "oracle"]
    refused = oracles if oracles == models else [name for name in oracles if name in values.model]
    if refused:
        raise UsageError(
            f"{refused[0]!r} needs the ground truth, which models do not get on track {REAL_TABLE}; leave it out."
        )
    return tuple(name for name in models if name not in oracles)


def _predictions_request(values: arguments.Run, sources: list[Source]) -> Request:
    if len(sources) > 1:
        raise UsageError("--predictions are of one track or dataset; name one.")
    if missing := [folder for folder in values.predictions if not folder.is_dir()]:
        raise UsageError(f"{missing[0]} is no folder; expected one with label maps.")
    resolved = [folder.resolve() for folder in values.predictions]
    if twice := [folder for folder in values.predictions if resolved.count(folder.resolve()) > 1]:
        raise UsageError(f"{twice[0]} is given twice in --predictions; expected one folder a seed, each another.")
    folders = tuple(PredictionFolder(folder, values.background_slot) for folder in values.predictions)
    return Request(models=(_name(values, resolved[0]),), sources=tuple(sources), predictions=folders)


def _weights(values: arguments.Run) -> tuple[Weights, ...]:
    """Load the weights that --checkpoint names."""
    if not values.checkpoint:
        return ()
    # PyTorch takes seconds to import.
    from obpose.scenes.model_ref import check_poses
    from obpose.storage.checkpoint import read_config

    folders = [find_checkpoint(folder).resolve() for folder in values.checkpoint]
    configs = [read_config(folder) for folder in folders]
    if values.task == "editing":
        for folder, config in zip(folders, configs, strict=True):
            check_poses(config, str(folder))
    found = tuple(
        Weights(system_of(config), folder, _name(values, folder))
        for folder, config in zip(folders, configs, strict=True)
    )
    names = [weights.name for weights in found]
    if twice := [name for name in names if names.count(name) > 1]:
        raise UsageError(
            f"Two of --checkpoint are called {twice[0]!r}; score them one by one, each with a --name of its own."
        )
    return found


def _name(values: arguments.Run, folder: Path) -> str:
    """Choose the name of a folder's label maps or weights in tables, files and keys."""
    name = folder.name if values.name is None else values.name
    check_model_name(name, "Give one with --name.")
    if twin := find_twin(name, row_names(discover()[0])):
        raise UsageError(f"{twin!r} is the name of a model; give what is in {folder} another with --name.")
    return name
