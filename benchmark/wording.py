"""Counts and caveats in words, the same on the screen, in the tables and in the report."""

import math
from collections.abc import Iterable

from benchmark.standings import Entry
from datagen.wording import counted


def mean_and_std(mean: float, std: float, digits: int = 2) -> str:
    """Format a score as the paper does; without a deviation where that is nan, as over one seed."""
    if math.isnan(mean):
        return "–"
    return f"{mean:z.{digits}f}" if math.isnan(std) else f"{mean:z.{digits}f}±{std:.{digits}f}"


def seeds_in_words(entries: Iterable[Entry]) -> str:
    """How many seeds the models have to which these make a difference; empty where there is no such model."""
    numbers = {entry.n_runs for entry in entries if entry.row.random}
    if not numbers:
        return ""
    fewest, most = min(numbers), max(numbers)
    return f"{'' if fewest == most else f'{fewest} to '}{counted(most, 'seed')}"


def run_once(entries: Iterable[Entry]) -> str:
    """Names of the models that were run once for several seeds, as these make no difference; empty where none was."""
    return ", ".join(sorted({entry.row.key.model for entry in entries if entry.n_runs < len(entry.rows)}))


def seeds_covered(entry: Entry) -> str:
    """How many seeds a mean is over, and of how many where some gave no scores."""
    return str(entry.n_scored) if entry.n_scored == entry.n_runs else f"{entry.n_scored} of {entry.n_runs}"


def rank_in_words(entry: Entry) -> str:
    """Such as 1, or 2.5 where two share places 2 and 3; empty where the model is not ranked."""
    return f"{entry.rank:g}" if entry.rank else ""


def without_floor(entries: Iterable[Entry]) -> str:
    """Name the tracks on which models compete without a floor, in a sentence; empty if there are none."""
    blind = [entry for entry in entries if entry.row.kind not in ("floor", "oracle") and math.isnan(entry.best_floor)]
    tracks = ", ".join(sorted({entry.row.key.track for entry in blind}))
    return f"No floor was scored on {tracks}: collapsed seeds cannot be detected there; add --model floors." * bool(
        blind
    )


def views_explained(entries: Iterable[Entry]) -> str:
    """What is said of views, where something is; else empty."""
    said = any(entry.views for entry in entries)
    return "Views: how many of a frame's views a model is given, and how many supervise it in training." * said


def free_of_slots(entries: Iterable[Entry]) -> str:
    """Which classical models say that they were not given the number of slots, in a sentence; empty where none does."""
    classical = [entry.row for entry in entries if entry.row.kind == "classical" and entry.n_scenes]
    free = {row.key.model for row in classical if "slots" not in row.priors}
    names = ", ".join(sorted(free))
    rest = "by their own account they find how many objects there are; see priors in leaderboard.csv."
    return f"Not held to the track's number of slots: {names}; {rest}" * bool(free)
