"""One trial: a system with some of its settings changed, trained once on a track, and its losses on validation clips.

What decides is how well the model explains images that it did not learn from; no clip of a trial carries a label.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmark.clips import ClipSequence
from benchmark.curves import save_curve
from benchmark.escaping import one_line
from benchmark.files import write_whole
from benchmark.model_spec import Options
from benchmark.registry import find_model
from benchmark.results import CURVES, TRAINING, build_checked, storable
from benchmark.tracks import Profile
from datagen.errors import CorruptFile, DatagenError
from datagen.safe_io import MOST_JSON_BYTES, brief_reason, parse_json, read_text
from datagen.storage import Dataset

TRIALS = "trials"
SEED = 0
"""Of every trial."""
OBSERVATION = ("colour loss", "surface loss", "air loss")
"""Terms of the observation loss in learning curves, which are what decides."""
TOTAL = "loss"
"""Decides where a system has none of them."""
_MEASURED = ("seconds", "validation_loss")
"""Numbers that are nan where a trial failed, and null in files."""


@dataclass(frozen=True)
class Trial:
    """What is to be trained."""

    model: str
    number: int
    """Of its declared trials; 0 changes nothing."""
    changes: Options
    base: Options
    """What is changed, where the model's settings are others by now."""
    track: str
    data: Path
    slots: int
    seconds: float
    """That it may learn for; infinite where it counts steps."""
    steps: int | None
    profile: Profile
    digest: str
    """Of everything that its outcome depends on."""
    out: Path

    trains = True

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{self.track}--{self.model}--trial{self.number}--{self.digest[:8]}"

    @property
    def results(self) -> tuple[str, ...]:
        """It has one."""
        return (self.name,)

    @property
    def options(self) -> dict[str, Any]:
        """What its model is made of."""
        steps = {} if self.steps is None else {"steps": self.steps}
        profile = {} if self.profile == "cpu" else {"profile": self.profile}
        folder = self.out / TRAINING / self.name
        return {"slots": self.slots, "folder": folder, "changes": {**self.base, **self.changes}, **steps, **profile}

    def run(self, announce: Callable[[str], None]) -> None:
        """Train, or go on, and write the outcome.

        Raises:
            DatagenError: the dataset is damaged, or the training gave no losses on validation clips.
        """
        spec, dataset = find_model(self.model), Dataset(self.data)
        model = spec.build(self.options)
        train, val = (ClipSequence(dataset.split(split)) for split in ("train", "val"))
        model.fit(train, val, seed=SEED, budget=self.seconds)
        points = getattr(model, "learning_curve", None) or ()
        curve = [{one_line(str(name)): float(value) for name, value in point.items()} for point in points]
        loss = observation_loss(curve[-1]) if curve else math.nan
        if not math.isfinite(loss):
            raise DatagenError(f"{self.model!r} has no finite loss on validation clips, by which trials are compared.")
        save_curve(self.out / CURVES / f"{self.name}.csv", curve)
        facts = {"steps": int(curve[-1].get("step", 0)), "seconds": curve[-1].get("seconds", math.nan)}
        save_outcome(self.out, Outcome.of(self, **facts, validation_loss=loss))
        announce(self.name)


@dataclass(frozen=True)
class Outcome:
    """What came of a trial."""

    name: str
    """Of the trial, settings included."""
    model: str
    trial: int
    changes: dict[str, Any]
    track: str
    steps: int
    """That were made; 0 where nobody knows."""
    seconds: float
    """Of the budget's clock."""
    validation_loss: float
    """At the end; nan where it failed."""
    reason: str = ""
    """Why it failed; empty where it did not."""

    @classmethod
    def of(cls, trial: Trial, **facts: Any) -> "Outcome":
        """Of that trial; where no more is said, one that failed."""
        unknown = {"steps": 0, "seconds": math.nan, "validation_loss": math.nan}
        there = {"name": trial.name, "model": trial.model, "trial": trial.number, "track": trial.track}
        return cls(**{**there, "changes": dict(trial.changes), **unknown, **facts})

    @property
    def place(self) -> tuple[str, int, str]:
        """Where it stands in the table, which has one outcome a place."""
        return self.model, self.trial, self.track


def observation_loss(point: Mapping[str, float]) -> float:
    """Colour, surface and air, or the total where a system has none of these.

    >>> observation_loss({"loss": 9.0, "colour loss": 1.0, "air loss": 0.5, "mask loss": 4.0})
    1.5
    >>> observation_loss({"loss": 9.0, "cross entropy loss": 9.0})
    9.0
    """
    terms = [point[name] for name in OBSERVATION if name in point]
    return sum(terms) if terms else point.get(TOTAL, math.nan)


def save_outcome(folder: Path, outcome: Outcome) -> None:
    """Write an outcome; from then on it counts."""
    # JSON has no nan.
    values = {name: None if value != value else storable(value) for name, value in asdict(outcome).items()}
    write_whole(folder / TRIALS / f"{outcome.name}.json", (json.dumps(values, indent=1, default=str) + "\n").encode())


def load_outcomes(folder: Path) -> Sequence[Outcome]:
    """All outcomes of a folder, by system, track and trial; none where there is no such folder yet.

    Raises:
        CorruptFile: one is damaged.
    """
    outcomes = [_load(path) for path in (folder / TRIALS).glob("*.json")]
    return sorted(outcomes, key=lambda outcome: (outcome.model, outcome.track, outcome.trial))


def _load(path: Path) -> Outcome:
    try:
        values: dict[str, Any] = parse_json(read_text(path, MOST_JSON_BYTES))
        unknown: dict[str, Any] = {name: math.nan for name in _MEASURED if values.get(name, "") is None}
        outcome = build_checked(Outcome, values | unknown)
        if outcome.name != path.stem:
            raise ValueError(f"it holds the outcome of {outcome.name}")
        return outcome
    except (ValueError, TypeError, AttributeError) as error:
        raise CorruptFile(
            f"{path} is damaged ({brief_reason(error)}); delete it and run the same command again."
        ) from None
