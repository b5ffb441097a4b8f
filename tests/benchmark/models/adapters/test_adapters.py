import json
import math
import shlex
from pathlib import Path
from typing import Any

import pytest
import tyro

from benchmark.commands.arguments import Run
from benchmark.commands.request import request_of
from benchmark.execution.plan import make_plan
from benchmark.machine import ROOT
from benchmark.models.model_spec import settings_of
from benchmark.models.registry import find_model
from benchmark.results.run_folder import load_runs
from obpose.baselines.obsurf.config import ObsurfConfig
from obpose.config import Config, override
from obpose.config_text import ADDED_LATER, dotted_values, to_plain
from obpose.contact.config import ContactConfig
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
    """A changed schema of the configuration changes keys, so that the published rows have to get the new ones."""
    monkeypatch.chdir(ROOT)
    values = tyro.cli(Run, args=shlex.split(command)[1:])
    plan = make_plan(request_of(values), load_runs(Path("docs") / values.out), values.out)
    assert plan.keys
    assert not plan.jobs


def test_commands_are_documented():
    assert len(documented()) > 7


def test_weights_state_their_own_priors_and_views(tmp_path: Path):
    config = make_config(**{"model.pose.conditioning": "none", "model.table": None, "train.views": "all"})
    (tmp_path / "config.json").write_text(json.dumps({"version": 1, "config": to_plain(config)}))
    declared = find_model("obpose")
    assert declared.configured
    found = declared.configured(tmp_path)
    assert set(declared.priors) - set(found.priors) == {"plane", "object size"}
    assert found.views
    assert found.views.on(4) == "4 in, 4 supervise"


@pytest.mark.parametrize("name", ["obpose", "obsurf", "supervised"])
def test_minutes_that_do_not_count_are_none_since_json_has_no_infinity(name: str):
    config = find_system(name).config(changes={"train.steps": 5, "train.minutes": math.inf})
    assert settings_of(config)["train"]["minutes"] is None


def test_later_values_count_only_if_they_are_not_the_defaults():
    default, wide = (settings_of(override(ContactConfig(), {"model.image_scale": scale})) for scale in (1, 2))
    assert "image_scale" not in default["model"]
    assert wide["model"]["image_scale"] == 2


@pytest.mark.parametrize("config", [Config(), ObsurfConfig()])
def test_every_value_counts(config: Any):
    values = [(name.rpartition(".")[2], value) for name, value in dotted_values(config)]
    names = [name for name, value in values if (name, value) not in ADDED_LATER.items()]
    plain = settings_of(config)

    def count(values: dict[str, object]) -> int:
        return sum(count(value) if isinstance(value, dict) else 1 for value in values.values())

    assert count(plain) == len(names)
