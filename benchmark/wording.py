"""Counts in words, the same on the screen, in the tables and in the report."""

from collections.abc import Iterable

from benchmark.standings import Entry


def counted(number: int, noun: str) -> str:
    """A number of things, such as "1 track" or "2 tracks"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


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
