"""One trial: a system with some of its settings changed, trained once on a track, and its losses on validation clips.

Trials are compared by how well the model explains held-out images; no clip of a trial carries a label.
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
"""Training seed of every trial."""
OBSERVATION = ("colour loss", "surface loss", "air loss")
"""Terms of the observation loss in learning curves; trials are compared by their sum."""
TOTAL = "loss"
"""Term that trials are compared by if a system has none of `OBSERVATION`."""
_MEASURED = ("seconds", "validation_loss")
"""Fields that are nan if a trial failed; null in files."""


@dataclass(frozen=True)
class Trial:
    """One training of a search: a model, its changed settings and a track."""

    model: str
    number: int
    """Index among the model's declared trials; 0 changes nothing."""
    changes: Options
    base: Options
    """Settings that the changes are applied to, if they differ from the model's defaults."""
    track: str
    data: Path
    slots: int
    seconds: float
    """Training budget in seconds; infinite if the budget is counted in steps."""
    steps: int | None
    profile: Profile
    digest: str
    """Hash of everything that the outcome depends on."""
    out: Path

    trains = True

    @property
    def name(self) -> str:
        """Name of the trial's files, without suffix."""
        return f"{self.track}--{self.model}--trial{self.number}--{self.digest[:8]}"

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the trial's results; there is one."""
        return (self.name,)

    @property
    def options(self) -> dict[str, Any]:
        """Constructor arguments of the trial's model."""
        steps = {} if self.steps is None else {"steps": self.steps}
        profile = {} if self.profile == "cpu" else {"profile": self.profile}
        folder = self.out / TRAINING / self.name
        return {"slots": self.slots, "folder": folder, "changes": {**self.base, **self.changes}, **steps, **profile}

    def run(self, announce: Callable[[str], None]) -> None:
        """Train, or resume training, and write the outcome.

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
    """Result of a trial."""

    name: str
    """Name of the trial; its hash covers the settings."""
    model: str
    trial: int
    changes: dict[str, Any]
    track: str
    steps: int
    """Training steps made; 0 if unknown."""
    seconds: float
    """Training time on the budget's clock."""
    validation_loss: float
    """Validation loss at the end; nan if the trial failed."""
    reason: str = ""
    """Reason of the failure; empty if the trial succeeded."""

    @classmethod
    def of(cls, trial: Trial, **facts: Any) -> "Outcome":
        """Build the outcome of a trial from the given facts; without facts, that of a failed trial."""
        unknown = {"steps": 0, "seconds": math.nan, "validation_loss": math.nan}
        there = {"name": trial.name, "model": trial.model, "trial": trial.number, "track": trial.track}
        return cls(**{**there, "changes": dict(trial.changes), **unknown, **facts})

    @property
    def place(self) -> tuple[str, int, str]:
        """Position in the table, which has one outcome per place."""
        return self.model, self.trial, self.track


def observation_loss(point: Mapping[str, float]) -> float:
    """Sum of the colour, surface and air losses, or the total loss if a system has none of these.

    >>> observation_loss({"loss": 9.0, "colour loss": 1.0, "air loss": 0.5, "mask loss": 4.0})
    1.5
    >>> observation_loss({"loss": 9.0, "cross entropy loss": 9.0})
    9.0
    """
    terms = [point[name] for name in OBSERVATION if name in point]
    return sum(terms) if terms else point.get(TOTAL, math.nan)


def save_outcome(folder: Path, outcome: Outcome) -> None:
    """Write an outcome; once written, the trial counts as finished."""
    # JSON has no nan.
    values = {name: None if value != value else storable(value) for name, value in asdict(outcome).items()}
    write_whole(folder / TRIALS / f"{outcome.name}.json", (json.dumps(values, indent=1, default=str) + "\n").encode())


def load_outcomes(folder: Path) -> Sequence[Outcome]:
    """Load all outcomes of a folder, sorted by system, track and trial; none if the folder does not exist yet.

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
