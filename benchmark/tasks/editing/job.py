"""Editing jobs: one model's edits of the test scenes of a track, scored and stored scene by scene."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.clips import ClipSequence
from benchmark.models.editor_interface import Editor
from benchmark.models.interface import Clip
from benchmark.results.scoring import SPLIT
from benchmark.tasks.editing.answers import Answer, answers_of, reference_answers
from benchmark.tasks.editing.lines import line_of, line_without_edit, load_lines, path_of, save_lines
from benchmark.tasks.editing.truth import EditedScene, Pair, kinds_in, read_edits
from datagen.errors import UsageError
from datagen.schema import EditKind
from datagen.storage.reader import Dataset, Split

VERSION = 1
"""Version of the scores; raise it when the scores of equal pictures change."""

Scored = Iterator[tuple[Pair, Answer]]
ReadEdits = Callable[[Split, int, Sequence[EditKind]], EditedScene]


@dataclass(frozen=True)
class EditJob:
    """Edits of one model on one track, to be scored; implements `benchmark.execution.executor.Runnable`."""

    track: str
    model: str
    """Name of the model in the tables."""
    data: Path
    """Dataset with edits."""
    checkpoint: Path | None
    """Weights of the model; None for the references."""
    refinements: int
    """Number of steps that fit inferred scenes to their frames."""
    scenes: int
    """Number of test scenes, from the first on."""
    digest: str
    """Hash of weights, dataset, refinements and version."""
    out: Path
    """The run folder."""

    @property
    def name(self) -> str:
        """Name of the job's file, without suffix."""
        return f"{self.track}--{self.model}--{self.digest[:8]}"

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the job's results; there is one."""
        return (self.name,)

    @property
    def path(self) -> Path:
        """Path of the job's lines."""
        return path_of(self.out, self.name)

    @property
    def state(self) -> tuple[Path, ...]:
        """The job's lines, to which it adds the missing ones."""
        return (self.path,)

    def missing(self) -> list[int]:
        """Scenes that have no line yet.

        Raises:
            UsageError: the file has lines of another track or model, whose names together make the same file name.
            CorruptFile: the file is damaged.
        """
        lines = load_lines(self.path)
        if others := [line for line in lines if (line["track"], line["model"]) != (self.track, self.model)]:
            raise UsageError(
                f"{self.path} has lines of {others[0]['model']} on {others[0]['track']}, expected {self.model} on "
                f"{self.track}. Give another folder with --out."
            )
        done = {line["scene"] for line in lines}
        return [scene for scene in range(self.scenes) if scene not in done]

    def run(self, announce: Callable[[str], None], read: ReadEdits = read_edits) -> None:
        """Score the missing scenes; calls `announce` after every scene, and with the job's name at the end.

        Raises:
            DatagenError: the dataset or the weights are damaged.
        """
        dataset = Dataset(self.data)
        scenes, kinds = dataset.split(SPLIT), kinds_in(dataset)
        clips, answer = ClipSequence(scenes), self._answer()
        lines = load_lines(self.path)
        for index in self.missing():
            truth = read(scenes, index, kinds)
            scored = answer(truth, lambda index=index: clips[index])
            new = [line_of(self.track, self.model, index, pair, found) for pair, found in scored]
            lines += new or [line_without_edit(self.track, self.model, index)]
            save_lines(self.path, lines)
            announce(f"scene {index}")
        announce(self.name)

    def _answer(self) -> Callable[[EditedScene, Callable[[], Clip]], Scored]:
        if self.checkpoint is None:
            return lambda truth, clip: reference_answers(truth.pairs)
        # PyTorch takes seconds to import.
        from benchmark.models.adapters.editor import SceneEditor

        editor: Editor = SceneEditor(self.checkpoint, refinements=self.refinements)
        return lambda truth, clip: answers_of(editor.infer(clip()), truth)
