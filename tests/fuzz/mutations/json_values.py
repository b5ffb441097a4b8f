"""Other values in JSON files."""

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
from numpy.random import Generator

from datagen.storage.spec import settings_hash, with_splits
from tests.fuzz.mutations.draw import pick

PLAIN = (
    None, True, False, 0, 1, -1, 2, 255, 2**31, 2**63, 10**18, 10**400, 0.5, -1e-9, 1e30, 1e308, float("nan"),
    float("inf"), "", "x", "train", "1", "../../x", "é\n[red]x", "a" * 10_000, [], {}, [None], [[]], [0, 0], {"": 0},
)  # fmt: skip
"""Values that stand in for a JSON value."""
NOT_JSON = ("", "null", "[]", "{", "nonsense", "1" * 5000, "[" * 100_000, '{"a":' * 100_000, "\ufeff{}", "\0")
"""Texts that stand in for a whole JSON text."""
NOT_UTF8 = b"\xff\xfe{\x00"


def change_json(path: Path, rng: Generator) -> str:
    """Another value in the place of one, or another text in the place of all."""
    if rng.random() < 0.05:
        path.write_bytes(NOT_UTF8)
        return "not UTF-8"
    text, change = changed_json(path.read_text(), rng)
    path.write_text(text)
    return change


def changed_json(text: str, rng: Generator) -> tuple[str, str]:
    """A JSON text with one change, and what that is."""
    if rng.random() < 0.12:
        other = pick(rng, NOT_JSON)
        return other, f"{other[:20]!r}"
    value = json.loads(text)
    value, change = changed_value(value, rng)
    return json.dumps(value), change


def changed_value(value: Any, rng: Generator) -> tuple[Any, str]:
    """Replace or delete a part of the value or put it in a list; gives the result and a description."""
    path = pick(rng, list(_paths(value)))
    if not path:
        return pick(rng, PLAIN), "all of it"
    parent = value
    for key in path[:-1]:
        parent = parent[key]
    old, how = parent[path[-1]], pick(rng, ("replace", "replace", "near", "near", "delete", "wrap", "add"))
    if how == "delete":
        del parent[path[-1]]
    elif how == "add":
        target = old if isinstance(old, dict | list) else parent
        target.update(unexpected=1) if isinstance(target, dict) else target.append(pick(rng, PLAIN))
    else:
        parent[path[-1]] = {"replace": pick(rng, PLAIN), "near": _near(old, rng), "wrap": [old]}[how]
    new = "" if how in ("delete", "add") else f" by {parent[path[-1]]!r:.40}"
    return value, f"{how} {'.'.join(map(str, path))}{new}"


def _near(old: Any, rng: Generator) -> Any:
    """Another value of the same type where there is one."""
    if isinstance(old, bool):
        return not old
    if isinstance(old, int | float):
        return pick(rng, (old + 1, -old, old * 1000, old / 2, 0, float(old), str(old)))
    if isinstance(old, str):
        return pick(rng, (old[:-1], old + old, old.upper(), "0" * len(old)))
    if isinstance(old, list):
        return pick(rng, (old[:-1], old + old, old[::-1], dict(enumerate(map(str, old)))))
    return pick(rng, PLAIN)


def _paths(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Keys that lead to each part of a value, itself included."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from _paths(item, (*path, key))


def change_spec(path: Path, rng: Generator) -> str:
    """Change a dataset's `dataset.json`, and make its hash and the shards beside it fit, as a forger would."""
    spec, change = changed_value(json.loads(path.read_text()), rng)
    with suppress(Exception):  # nothing fits a spec that is none
        spec = with_splits(spec, spec["splits"])
        for shard in path.parent.glob("*.h5"):
            with h5py.File(shard, "r+") as file:
                file.attrs["settings_hash"] = settings_hash(spec)
    path.write_text(json.dumps(spec))
    return f"signed, {change}"
