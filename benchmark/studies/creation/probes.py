"""Linear probes: what can be read from a latent by a linear map, and so what it holds, and what it leaves out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Shaped
from sklearn.linear_model import LogisticRegression, RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from benchmark.ranking.statistics import interval

ALPHAS = 10.0 ** np.arange(-3, 5)
"""Strengths of ridge regression, chosen on the objects that it learns from (leave one out)."""
MOST_STEPS = 2000
RESAMPLES = 1000


@dataclass(frozen=True, eq=False)
class Sample:
    """Objects, what is known of each, and what is to be read from it."""

    inputs: Float[np.ndarray, "object feature"]
    values: Shaped[np.ndarray, "object *target"]
    """Numbers or names."""
    scene: Int[np.ndarray, "object"]
    """That an object is in."""


@dataclass(frozen=True)
class Probe:
    """What a probe reads on objects that it did not learn from."""

    score: float
    """R^2 of numbers, the share of right answers of names."""
    low: float
    """95 % interval over scenes."""
    high: float
    baseline: float
    """The same of the answer that needs no input: the mean, or the most frequent name, of the objects learned from."""
    trained: int
    """Objects learned from."""
    tested: int


def probe_numbers(learned: Sample, tested: Sample) -> Probe:
    """Ridge regression; of several numbers R^2 is that of all together, by their squared errors in one unit."""
    model = make_pipeline(StandardScaler(), RidgeCV(ALPHAS)).fit(learned.inputs, learned.values)
    count = len(tested.inputs)
    truth = tested.values.reshape(count, -1).astype(np.float64)
    mean = np.broadcast_to(learned.values.mean(axis=0), tested.values.shape)
    wrong, wrong_mean = (
        np.sum((truth - answer.reshape(count, -1)) ** 2, axis=1) for answer in (model.predict(tested.inputs), mean)
    )
    spread = np.sum((truth - truth.mean(axis=0)) ** 2, axis=1)
    baseline = 1 - wrong_mean.sum() / spread.sum()
    return _probe(lambda part: 1 - wrong[part].sum() / spread[part].sum(), float(baseline), learned, tested)


def probe_names(learned: Sample, tested: Sample) -> Probe:
    """Logistic regression."""
    model = make_pipeline(StandardScaler(), LogisticRegression(max_iter=MOST_STEPS))
    right = model.fit(learned.inputs, learned.values).predict(tested.inputs) == tested.values
    known, counts = np.unique(learned.values, return_counts=True)
    baseline = float(np.mean(tested.values == known[np.argmax(counts)]))
    return _probe(lambda part: right[part].mean(), baseline, learned, tested)


def _probe(score: Callable[[np.ndarray], float], baseline: float, learned: Sample, tested: Sample) -> Probe:
    """With an interval by drawing scenes anew."""
    rng, every = np.random.default_rng(0), np.arange(len(tested.scene))
    members = [np.flatnonzero(tested.scene == scene) for scene in np.unique(tested.scene)]
    drawn = [
        score(np.concatenate([members[i] for i in rng.integers(len(members), size=len(members))]))
        for _ in range(RESAMPLES)
    ]
    low, high = interval(np.array(drawn))
    return Probe(float(score(every)), low, high, baseline, len(learned.scene), len(tested.scene))
