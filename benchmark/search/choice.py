"""Which trial of a system is chosen: the one with the best mean rank in validation loss over all tracks.

The rule is declared here, before any search, and knows no label. Ranks, as losses of different tracks have no common
unit; of equal mean ranks the lower mean of standardised losses decides, and then the lower number. A trial that failed
on a track, or was not made there, is never chosen.
"""

from collections.abc import Iterable, Sequence
from itertools import groupby

import numpy as np
from jaxtyping import Float, Float64

from benchmark import statistics
from benchmark.search.trial import Outcome

Losses = Float[np.ndarray, "trial track"]


def choices(outcomes: Iterable[Outcome]) -> dict[str, int]:
    """The number of the chosen trial of every system that has one."""
    ordered = sorted(outcomes, key=lambda outcome: outcome.model)
    found = {model: _choice(list(members)) for model, members in groupby(ordered, key=lambda outcome: outcome.model)}
    return {model: trial for model, trial in found.items() if trial is not None}


def best_trial(losses: Losses) -> int | None:
    """The row that is chosen; nan where a trial has no loss.

    >>> best_trial(np.array([[2.0, 40.0], [1.0, 60.0], [1.5, 30.0]]))
    2
    """
    whole = np.flatnonzero(~np.isnan(losses).any(axis=1)).tolist()
    if not whole:
        return None
    ranks, distances = mean_ranks(losses), standardised(losses)
    return min(whole, key=lambda row: (ranks[row], distances[row], row))


def mean_ranks(losses: Losses) -> Float64[np.ndarray, " trial"]:
    """Of each trial over tracks; 1 is the lowest loss, none the last."""
    return np.mean([statistics.ranks(-column) for column in losses.T], axis=0)


def standardised(losses: Losses) -> Float64[np.ndarray, " trial"]:
    """Mean over tracks of the losses, less their mean over trials, in units of their deviation; nan where one is."""
    spread = np.nanstd(losses, axis=0)
    return np.mean((losses - np.nanmean(losses, axis=0)) / np.where(spread > 0, spread, 1.0), axis=1)


def _choice(outcomes: Sequence[Outcome]) -> int | None:
    trials, tracks = (sorted({getattr(outcome, name) for outcome in outcomes}) for name in ("trial", "track"))
    losses = np.full((len(trials), len(tracks)), np.nan)
    for outcome in outcomes:
        losses[trials.index(outcome.trial), tracks.index(outcome.track)] = outcome.validation_loss
    row = best_trial(losses)
    return None if row is None else trials[row]
