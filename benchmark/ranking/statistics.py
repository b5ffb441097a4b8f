"""Uncertainty of scores: means, intervals, paired differences, and groups without significant differences.

Scores are arrays (seed, scene) of per-scene means over frames, with the number of frames behind each as weights. A
split's score pools its frames: sum(score * weight) / sum(weight); a model's score is the mean of that over its seeds.

Properties of the intervals:
- Seeds and scenes are resampled crossed, because all seeds are scored on the same scenes. Nested resampling draws
  scenes anew within each seed; its intervals are too narrow.
- Three seeds under-cover: if most of the spread is between seeds, nominal 95 % intervals contain the true score in
  about 75 % of simulated experiments. Tables therefore show the standard deviation over seeds as well.
- With one seed, or a method without randomness, only scenes are resampled.
- Differences between two models are paired by scene, after a mean over each model's seeds. They describe the runs that
  were made, not what another training would give.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64

RESAMPLES = 10_000
CONFIDENCE = 0.95
SIGNIFICANCE = 0.05

RESOLVABLE = 1.96 + 0.84
"""Detectable difference in standard errors: significant at 5 % in 80 % of all samples of scenes."""

TIE = 1.5e-6
"""Largest difference of equal scores: packed results have six decimals, and means over seeds have rounding errors."""

Scores = Float[np.ndarray, "seed scene"]
"""Scores, which are nan only where the weight is 0."""
OtherScores = Float[np.ndarray, "other_seed scene"]


@dataclass(frozen=True, eq=False)
class Resamples:
    """Bootstrap samples as counts: how often each scene, and each seed, was drawn. One draw serves many models."""

    scenes: Float64[np.ndarray, "resample scene"]
    seeds: Float64[np.ndarray, "resample seed"]


@dataclass(frozen=True)
class Summary:
    """One metric of one model over its seeds; all nan where it is defined nowhere."""

    mean: float
    std: float
    """Population standard deviation over seeds (divided by n), as the paper prints it."""
    sample_std: float
    """Divided by n - 1; nan with one seed."""
    low: float
    high: float
    """Ends of the 95 % bootstrap interval of the mean."""


@dataclass(frozen=True)
class Difference:
    """Score difference of two models, the first minus the second, paired by scene."""

    mean: float
    low: float
    high: float
    """Ends of the 95 % bootstrap interval."""
    p_value: float
    """Two-sided p-value of the difference."""
    win_rate: float
    """Share of scenes in which the first scores more; equal scores are half a win."""
    resolvable: float
    """Smallest true difference that this many scenes can detect (5 % significance, 80 % power)."""
    n_scenes: int
    """Scenes in which both scores are defined."""


NO_DIFFERENCE = Difference(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, 0)
"""Placeholder for models that have no scene in common."""


def pooled_means(scores: Scores, weights: Scores) -> Float64[np.ndarray, "seed"]:
    """Each seed's mean over all frames; nan where no frame defines the metric."""
    return _ratio(np.nansum(scores * weights, axis=1), weights.sum(axis=1))


def draw(n_seeds: int, n_scenes: int, rng: np.random.Generator, resamples: int = RESAMPLES) -> Resamples:
    """Draw scenes and, independently, seeds with replacement.

    All seeds of a run have the same scenes, so one draw of scenes serves them all (the pigeonhole bootstrap of Owen,
    2007). Equal generators draw equal scenes, however many seeds there are.
    """
    return Resamples(_draw_counts(n_scenes, resamples, rng), _draw_counts(n_seeds, resamples, rng))


def spread(values: Float[np.ndarray, "seed"]) -> tuple[float, float, float]:
    """Mean, population and sample standard deviation over seeds; undefined seeds are left out."""
    defined = values[~np.isnan(values)]
    if len(defined) == 0:
        return math.nan, math.nan, math.nan
    sample = float(defined.std(ddof=1)) if len(defined) > 1 else math.nan
    return float(defined.mean()), float(defined.std()), sample


def summarise(scores: Scores, weights: Scores, resamples: Resamples) -> Summary:
    """Mean over seeds and its interval; `resamples` are for exactly this many seeds and scenes."""
    means = _resampled_means(scores, weights, resamples.scenes)
    chosen = resamples.seeds * ~np.isnan(means)
    low, high = interval(_ratio(np.nansum(means * chosen, axis=1), chosen.sum(axis=1)))
    return Summary(*spread(pooled_means(scores, weights)), low, high)


def interval(values: Float[np.ndarray, "resample"]) -> tuple[float, float]:
    """Percentiles that hold the middle 95 %; nan where nothing is defined."""
    defined = values[~np.isnan(values)]
    if len(defined) == 0:
        return math.nan, math.nan
    low, high = np.quantile(defined, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def difference(one: tuple[Scores, Scores], two: tuple[OtherScores, OtherScores], resamples: Resamples) -> Difference:
    """Paired difference of two models, each given as scores and weights over the same scenes.

    The p-value is that of the bootstrap centred on the difference found (Hall and Wilson, 1991); with N resamples it is
    at least 1 / (N + 1).

    Raises:
        ValueError: the numbers of scenes differ.
    """
    # Scenes that both models define.
    first, second = mean_over_seeds(*one), mean_over_seeds(*two)
    both = (first[1] > 0) & (second[1] > 0)
    if not both.any():
        return NO_DIFFERENCE
    (x, v), (y, w) = ([np.where(both, part, 0.0)[None] for part in model] for model in (first, second))
    found = float(pooled_means(x, v)[0] - pooled_means(y, w)[0])
    # Bootstrap over scenes: the same draws for both models.
    drawn = (_resampled_means(x, v, resamples.scenes) - _resampled_means(y, w, resamples.scenes))[:, 0]
    drawn = drawn[~np.isnan(drawn)]
    # Share of scenes that the first model wins; ties count half.
    wins = np.where(np.abs(x - y) <= TIE, 0.5, x > y)[0, both]
    return Difference(
        mean=found,
        low=interval(drawn)[0],
        high=interval(drawn)[1],
        p_value=_p_value(found, drawn) if both.sum() > 1 else math.nan,
        win_rate=float(wins.mean()),
        resolvable=float(RESOLVABLE * drawn.std()) if both.sum() > 1 else math.nan,
        n_scenes=int(both.sum()),
    )


def mean_over_seeds(
    scores: Scores, weights: Scores
) -> tuple[Float64[np.ndarray, "scene"], Float64[np.ndarray, "scene"]]:
    """Each scene's mean over seeds, and the mean number of frames behind it."""
    return _ratio(np.nansum(scores * weights, axis=0), weights.sum(axis=0)), weights.mean(axis=0)


def holm(p_values: Float[np.ndarray, "test"]) -> Float64[np.ndarray, "test"]:
    """Correct p-values for multiple tests (Holm, 1979); nan values are not counted as tests and stay nan."""
    corrected = np.full(len(p_values), np.nan)
    tests = np.flatnonzero(~np.isnan(p_values))
    order = tests[np.argsort(p_values[tests], kind="stable")]
    factors = np.arange(len(order), 0, -1)
    corrected[order] = np.minimum(np.maximum.accumulate(p_values[order] * factors), 1.0)
    return corrected


def tied_groups(different: Bool[np.ndarray, "model model"]) -> list[tuple[int, ...]]:
    """Find the largest groups of models without a significant difference; a model may be in several.

    Groups come in the order of their members' indices: with models sorted by score, the first group is the best's.
    The compact letter display by insertion and absorption (Piepho, 2004).
    """
    groups = [frozenset(range(len(different)))] if len(different) else []
    for one, two in zip(*np.nonzero(np.triu(different | different.T, 1)), strict=True):
        split = [
            part for group in groups for part in ((group - {one}, group - {two}) if {one, two} <= group else (group,))
        ]
        groups = [group for group in dict.fromkeys(split) if not any(group < other for other in split)]
    return sorted(tuple(sorted(int(model) for model in group)) for group in groups)


def ranks(scores: Float[np.ndarray, "model"]) -> Float64[np.ndarray, "model"]:
    """Ranks of scores, 1 for the highest; equal scores share the mean of their ranks, undefined ones are last."""
    values = np.where(np.isnan(scores), -np.inf, scores)
    above = (values[None] > values[:, None]).sum(axis=1)
    equal = (values[None] == values[:, None]).sum(axis=1)
    return above + (equal + 1) / 2


def mean_ranks(ari_fg: Float[np.ndarray, "model"], msc_fg: Float[np.ndarray, "model"]) -> Float64[np.ndarray, "model"]:
    """Mean of the ranks in ARI-FG and MSC-FG. ARI-FG alone is blind to segments that leak into the background."""
    return (ranks(ari_fg) + ranks(msc_fg)) / 2


def _resampled_means(
    scores: Scores, weights: Scores, scenes: Float64[np.ndarray, "resample scene"]
) -> Float64[np.ndarray, "resample seed"]:
    totals = scenes @ np.nan_to_num(scores * weights).T
    return _ratio(totals, scenes @ weights.T)


def _draw_counts(n: int, resamples: int, rng: np.random.Generator) -> Float64[np.ndarray, "resample n"]:
    # Row by row, since temporary arrays of all resamples would take several times the memory.
    counts = np.empty((resamples, n))
    for row in counts:
        row[:] = np.bincount(rng.integers(n, size=n), minlength=n)
    return counts


def _p_value(found: float, drawn: Float64[np.ndarray, "resample"]) -> float:
    # Rounding errors must not make a constant difference of 0 significant.
    as_large = np.abs(drawn - found) >= abs(found) - 1e-12
    return float((1 + as_large.sum()) / (1 + len(drawn)))


def _ratio(totals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.where(weights > 0, totals / np.where(weights > 0, weights, 1.0), np.nan)
