import json
import math
import shlex
from functools import reduce
from pathlib import Path
from typing import Literal, get_args, get_origin, get_type_hints

import pytest
import tyro

from benchmark.commands.arguments import Run
from benchmark.commands.request import request_of
from benchmark.execution.plan import make_plan
from benchmark.machine import ROOT
from benchmark.models.adapters.settings import LATER, settings_of
from benchmark.models.registry import find_model
from benchmark.results.run_folder import load_runs
from obpose.baselines.obsurf.config import ObsurfConfig
from obpose.config import Config, override
from obpose.config_text import dotted_values, to_plain
from obpose.systems import find_system
from obpose.variants import make_config

PAGES = (ROOT / "docs" / "results.md", *sorted((ROOT / "docs" / "results").glob("*.md")))


def documented() -> list[str]:
    """Commands that made the rows in docs/results, in folders of the same names in results."""
    lines = [line.strip() for page in PAGES for line in page.read_text().replace("\\\n", " ").splitlines()]
    made = [line for line in lines if line.startswith("obpose-bench --model") and "--out results" in line]
    return [line for line in dict.fromkeys(made) if not any(part in line for part in ("$", "--pretrained", "--data"))]


@pytest.mark.parametrize("command", documented())
def test_rows_that_were_published_are_found_by_the_commands_beside_them(command: str, monkeypatch: pytest.MonkeyPatch):
    """A value that was added to a configuration since goes into `LATER`, with what was done before. A default that was
    changed makes rows invalid, and they have to be made anew."""
    monkeypatch.chdir(ROOT)
    values = tyro.cli(Run, args=shlex.split(command)[1:])
    plan = make_plan(request_of(values), load_runs(Path("docs") / values.out), values.out)
    assert plan.keys
    assert not plan.jobs


def test_commands_are_documented():
    assert len(documented()) > 7


@pytest.mark.parametrize(("name", "before"), LATER[Config].items())
def test_a_value_that_came_later_stands_in_the_settings_where_it_is_another(name: str, before: object):
    assert dict(dotted_values(make_config()))[name] == before
    other = _another(name, before)
    assert settings_of(override(make_config(), {name: other})) != settings_of(make_config())


def _another(name: str, value: object) -> object:
    """A value that may stand there, but not this one."""
    kind = reduce(lambda kind, part: get_type_hints(kind)[part], name.split("."), Config)
    if get_origin(kind) is Literal:
        return next(choice for choice in get_args(kind) if choice != value)
    return 7 if kind is int else 0.77


def test_weights_state_their_own_priors_and_views(tmp_path: Path):
    config = make_config(**{"model.floor": None, "model.table": None, "train.views": "all"})
    (tmp_path / "config.json").write_text(json.dumps({"version": 1, "config": to_plain(config)}))
    declared = find_model("obpose")
    assert declared.configured
    found = declared.configured(tmp_path)
    assert set(declared.priors) - set(found.priors) == {"plane"}
    assert found.views
    assert found.views.on(4) == "4 in, 4 supervise"


@pytest.mark.parametrize("name", ["obpose", "obsurf", "supervised"])
def test_minutes_that_do_not_count_are_none_since_json_has_no_infinity(name: str):
    config = find_system(name).config(changes={"train.steps": 5, "train.minutes": math.inf})
    assert settings_of(config)["train"]["minutes"] is None


def test_slot_attention_counts_only_where_it_is_used():
    changes = {"model.slot_attention.iterations": 7}
    assert settings_of(make_config(**changes)) == settings_of(make_config())
    assert settings_of(make_config("slot-attention", **changes)) != settings_of(make_config("slot-attention"))


def test_of_other_systems_every_value_counts():
    names = {name for name, _ in dotted_values(ObsurfConfig())}
    plain = settings_of(ObsurfConfig())

    def count(values: dict[str, object]) -> int:
        return sum(count(value) if isinstance(value, dict) else 1 for value in values.values())

    assert count(plain) == len(names)
