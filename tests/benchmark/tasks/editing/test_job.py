from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.names import REFERENCES
from benchmark.tasks.editing.job import EditJob
from benchmark.tasks.editing.lines import line_without_edit, load_lines, save_lines
from benchmark.tasks.editing.truth import EditedScene, read_edits
from datagen.errors import UsageError
from datagen.schema import EditKind
from datagen.storage.reader import Split
from tests.benchmark.tasks.editing import oracle


def some_job(edits: Path, out: Path, scenes: int = oracle.SCENES) -> EditJob:
    return EditJob("moving", REFERENCES, edits, None, 0, scenes, "0123456789", out)


def test_lines_of_another_model_are_not_taken_for_its_own(edits: Path, tmp_path: Path):
    """Names of tracks and models may hold what joins them in the name of the file."""
    job = replace(some_job(edits, tmp_path), track="a--b", model="c")
    save_lines(job.path, [line_without_edit("a", "b--c", 0)])
    assert replace(job, track="a", model="b--c").missing() == [1]
    with pytest.raises(UsageError, match="has lines of b--c on a, expected c on a--b"):
        job.missing()


def test_a_job_scores_every_scene_edit_and_answer(edits: Path, tmp_path: Path):
    heard: list[str] = []
    job = some_job(edits, tmp_path)
    job.run(heard.append)
    assert heard == ["scene 0", "scene 1", *job.results]
    lines = load_lines(job.path)
    assert len({(line["scene"], line["edit"], line["answer"]) for line in lines}) == len(lines) == 2 * 3 * 2
    assert job.missing() == []


def test_a_job_that_was_stopped_goes_on_and_comes_to_the_same(edits: Path, tmp_path: Path):
    whole, begun = some_job(edits, tmp_path / "whole"), some_job(edits, tmp_path / "begun")
    whole.run(lambda event: None)
    save_lines(begun.path, [line for line in load_lines(whole.path) if line["scene"] == 0])
    heard: list[str] = []
    begun.run(heard.append)
    assert heard == ["scene 1", begun.name]
    assert begun.path.read_text() == whole.path.read_text()


def test_more_scenes_extend_a_job(edits: Path, tmp_path: Path):
    some_job(edits, tmp_path, scenes=1).run(lambda event: None)
    assert some_job(edits, tmp_path).missing() == [1]


def test_a_scene_that_has_nothing_to_edit_is_done_once(edits: Path, tmp_path: Path):
    def empty(scenes: Split, index: int, kinds: Sequence[EditKind]) -> EditedScene:
        return replace(read_edits(scenes, index, kinds), pairs=())

    job = some_job(edits, tmp_path)
    job.run(lambda event: None, empty)
    assert job.missing() == []
