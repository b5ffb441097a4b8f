"""Results of a search: `search.csv`, and a table and the choice on the screen."""

import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from pathlib import Path

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from benchmark.escaping import one_line, terminal
from benchmark.files import write_whole
from benchmark.leaderboard import Line, to_csv
from benchmark.search.choice import choices
from benchmark.search.trial import Outcome

SEARCH = "search.csv"


def write(folder: Path, outcomes: Sequence[Outcome]) -> Path:
    """Write the table of all trials, and return its path."""
    write_whole(folder / SEARCH, to_csv(lines(outcomes)).encode())
    return folder / SEARCH


def lines(outcomes: Sequence[Outcome]) -> list[Line]:
    """Build one line per trial and track."""
    chosen = choices(outcomes)
    return [
        {
            "system": outcome.model,
            "trial": outcome.trial,
            "changes": json.dumps(outcome.changes, sort_keys=True, default=str),
            "track": outcome.track,
            "steps": outcome.steps,
            "seconds": outcome.seconds,
            "validation_loss": outcome.validation_loss,
            "chosen": "yes" if chosen.get(outcome.model) == outcome.trial else "no",
            "failure": outcome.reason,
        }
        for outcome in outcomes
    ]


def shown(outcomes: Sequence[Outcome]) -> Group:
    """Format the losses by track and the choice of every system, for the terminal."""
    chosen = choices(outcomes)
    tracks = list(dict.fromkeys(outcome.track for outcome in outcomes))
    table = Table("system", "trial", "changes", *(escape(one_line(track)) for track in tracks), "", box=None)
    for (model, trial), members in _by_trial(outcomes):
        losses = {outcome.track: outcome for outcome in members}
        cells = [_loss(losses.get(track)) for track in tracks]
        mark = "chosen" if chosen.get(model) == trial else ""
        table.add_row(*map(terminal, (model, str(trial), in_words(members[0].changes), *cells, mark)))
    return Group(table, "", *map(terminal, _choices(outcomes, chosen)))


def in_words(changes: Mapping[str, object]) -> str:
    """Format changed settings, such as `train.learning_rate=0.003`."""
    return ", ".join(f"{name}={value}" for name, value in changes.items()) or "its defaults"


def _choices(outcomes: Sequence[Outcome], chosen: Mapping[str, int]) -> Iterable[str]:
    for model, members in groupby(outcomes, key=lambda outcome: outcome.model):
        found = {outcome.trial: outcome.changes for outcome in members}
        if model not in chosen:
            yield f"{model}: no trial gave a loss on every track."
            continue
        changes = in_words(found[chosen[model]])
        yield f"{model}: {changes} (trial {chosen[model]} of {len(found)}, by validation loss)."


def _by_trial(outcomes: Sequence[Outcome]) -> Iterable[tuple[tuple[str, int], list[Outcome]]]:
    ordered = sorted(outcomes, key=lambda outcome: (outcome.model, outcome.trial))
    for key, members in groupby(ordered, key=lambda outcome: (outcome.model, outcome.trial)):
        yield key, list(members)


def _loss(outcome: Outcome | None) -> str:
    if outcome is None:
        return ""
    return "failed" if outcome.reason else f"{outcome.validation_loss:.4f}"
