"""Linear probes: what can be read from a latent by a linear map, and so what it holds, and what it leaves out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Shaped
from sklearn.linear_model import LogisticRegression, RidgeCV
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import StandardScaler

from benchmark.statistics import interval

ALPHAS = 10.0 ** np.arange(-3, 5)
"""Strengths of ridge regression, chosen on the objects that it learns from (leave one out)."""
MOST_STEPS = 2000
RESAMPLES = 1000

Inputs = Float[np.ndarray, "object feature"]
Values = Shaped[np.ndarray, "object *target"]


@dataclass(frozen=True)
class Probe:
    """What a probe reads on objects that it did not learn from."""

    score: float
    """R^2 of numbers, the share of right answers of names."""
    low: float
    """95 % interval over scenes."""
    high: float
    baseline: float
    """The same of the answer that needs no input: the mean, of which R^2 is measured, or the most frequent name."""
    trained: int
    """Objects learned from."""
    tested: int


def probe_numbers(
    inputs: Inputs, values: Values, test_inputs: Inputs, test_values: Values, test_scenes: Int[np.ndarray, "object"]
) -> Probe:
    """Ridge regression; of several numbers R^2 is that of all together, by their squared errors in one unit.

    The baseline is the mean of the objects learned from, measured by the mean of those tested.
    """
    model = make_pipeline(StandardScaler(), RidgeCV(ALPHAS)).fit(inputs, values)
    wide = (test_values if test_values.ndim == 2 else test_values[:, None]).astype(np.float64)
    squares = [
        np.sum((wide - answer.reshape(len(answer), -1)) ** 2, axis=1)
        for answer in (model.predict(test_inputs), np.broadcast_to(values.mean(axis=0), test_values.shape))
    ]
    spread = np.sum((wide - wide.mean(axis=0)) ** 2, axis=1)
    share = lambda part: 1 - squares[0][part].sum() / spread[part].sum()  # noqa: E731
    baseline = 1 - squares[1].sum() / spread.sum()
    return _probe(share, float(baseline), len(inputs), test_scenes)


def probe_names(
    inputs: Inputs, names: Values, test_inputs: Inputs, test_names: Values, test_scenes: Int[np.ndarray, "object"]
) -> Probe:
    """Logistic regression; the baseline always says the name that is most frequent among those learned from."""
    model: Pipeline = make_pipeline(StandardScaler(), LogisticRegression(max_iter=MOST_STEPS)).fit(inputs, names)
    right = model.predict(test_inputs) == test_names
    known, counts = np.unique(names, return_counts=True)
    baseline = float(np.mean(test_names == known[np.argmax(counts)]))
    return _probe(lambda part: right[part].mean(), baseline, len(inputs), test_scenes)


def _probe(
    score: Callable[[np.ndarray], float], baseline: float, trained: int, scenes: Int[np.ndarray, "object"]
) -> Probe:
    rng, every = np.random.default_rng(0), np.arange(len(scenes))
    members = [np.flatnonzero(scenes == scene) for scene in np.unique(scenes)]
    drawn = [
        score(np.concatenate([members[i] for i in rng.integers(len(members), size=len(members))]))
        for _ in range(RESAMPLES)
    ]
    low, high = interval(np.array(drawn))
    return Probe(float(score(every)), low, high, baseline, trained, len(scenes))
