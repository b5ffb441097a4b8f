"""Counts and caveats in words, the same on the screen, in the tables and in the report."""

import math
from collections.abc import Iterable

from benchmark.ranking.standings import Entry
from datagen.console.text import counted


def mean_and_std(mean: float, std: float, digits: int = 2) -> str:
    """Format a score as in the paper; the deviation is left out if it is nan, as for one seed."""
    if math.isnan(mean):
        return "–"
    return f"{mean:z.{digits}f}" if math.isnan(std) else f"{mean:z.{digits}f}±{std:.{digits}f}"


def seeds_in_words(entries: Iterable[Entry]) -> str:
    """Number of seeds of the models that depend on seeds; empty if there is no such model."""
    numbers = {entry.n_runs for entry in entries if entry.row.random}
    if not numbers:
        return ""
    fewest, most = min(numbers), max(numbers)
    return f"{'' if fewest == most else f'{fewest} to '}{counted(most, 'seed')}"


def run_once(entries: Iterable[Entry]) -> str:
    """Names of the models that were run once for all seeds, because seeds make no difference; empty if none was."""
    return ", ".join(sorted({entry.row.key.model for entry in entries if entry.n_runs < len(entry.rows)}))


def seeds_covered(entry: Entry) -> str:
    """Number of seeds that a mean is over, and of all seeds if some gave no scores."""
    return str(entry.n_scored) if entry.n_scored == entry.n_runs else f"{entry.n_scored} of {entry.n_runs}"


def rank_in_words(entry: Entry) -> str:
    """Format a rank, such as 1, or 2.5 if two models share places 2 and 3; empty if the model is not ranked."""
    return f"{entry.rank:g}" if entry.rank else ""


def without_floor(entries: Iterable[Entry]) -> str:
    """Name the tracks on which models compete without a floor, in a sentence; empty if there are none."""
    blind = [entry for entry in entries if entry.row.kind not in ("floor", "oracle") and math.isnan(entry.best_floor)]
    tracks = ", ".join(sorted({entry.row.key.track for entry in blind}))
    return f"No floor was scored on {tracks}: collapsed seeds cannot be detected there; add --model floors." * bool(
        blind
    )


def views_explained(entries: Iterable[Entry]) -> str:
    """Explain the column of views, if any model declares its views; otherwise empty."""
    said = any(entry.views for entry in entries)
    return "Views: how many of a frame's views a model is given, and how many supervise it in training." * said


def free_of_slots(entries: Iterable[Entry]) -> str:
    """Name the classical models that are not given the number of slots, in a sentence; empty if there are none."""
    classical = [entry.row for entry in entries if entry.row.kind == "classical" and entry.n_scenes]
    free = {row.key.model for row in classical if "slots" not in row.priors}
    names = ", ".join(sorted(free))
    rest = "by their own account they find how many objects there are; see priors in leaderboard.csv."
    return f"Not held to the track's number of slots: {names}; {rest}" * bool(free)
