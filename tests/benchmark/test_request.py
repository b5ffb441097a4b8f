"""Datasets that cannot be scored on are refused before anything runs."""

import json
from pathlib import Path

import pytest

from benchmark.arguments import Run
from benchmark.request import request_of
from datagen import config, spec
from datagen.errors import UsageError
from tests.fabricated import spheres_recipe, write_dataset


def request(folder: Path) -> None:
    request_of(Run(model=("plane-dbscan",), data=folder, out=folder.parent / "out"))


def test_a_dataset_of_images_is_accepted(tmp_path: Path):
    request(write_dataset(tmp_path / "data", scenes=1, frames=1))


def test_a_dataset_without_images_is_refused(tmp_path: Path):
    recipe = config.recipe_to_dict(spheres_recipe())
    facts = spec.make_spec(recipe, seed=0, splits={"test": 1}, resolution=None, renderer=None)
    (tmp_path / spec.SPEC_FILE).write_text(json.dumps(facts))
    with pytest.raises(UsageError, match=r"holds no images; make them with: obpose-datagen render --from"):
        request(tmp_path)


def test_a_dataset_without_test_scenes_is_refused(tmp_path: Path):
    with pytest.raises(UsageError, match="has no test scenes to score on"):
        request(write_dataset(tmp_path / "data", scenes=0))
