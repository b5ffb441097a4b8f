"""`obpose-bench --task editing`: score the edits of trained models, and write the tables."""

import glob
from collections.abc import Sequence
from dataclasses import replace

from benchmark.commands import arguments
from benchmark.commands.outputs import prepare, print_path, wide_console
from benchmark.commands.request import job_limits, places
from benchmark.execution.executor import Outcome, run_jobs
from benchmark.execution.jobs import GRACE_SECONDS
from benchmark.execution.plan import Request, Weights, trained
from benchmark.models.registry import find_model
from benchmark.names import REFERENCES, REFINED
from benchmark.ranking.text import terminal
from benchmark.results.run_folder import digest
from benchmark.results.scoring import SPLIT
from benchmark.tasks.editing import summary
from benchmark.tasks.editing.job import VERSION, EditJob
from benchmark.tasks.editing.lines import FOLDER
from benchmark.tasks.editing.truth import kinds_in
from datagen.console.progress import progress_bar, status_console
from datagen.console.text import counted
from datagen.errors import EXIT_INCOMPLETE, EXIT_OK, UsageError
from datagen.schema import EDITS
from datagen.storage.atomic import remove_abandoned
from datagen.storage.reader import Dataset
from datagen.tracks import Source, Track
from obpose.storage.pretrained import content_hash


def score_edits(values: arguments.Run, request: Request) -> int:
    """Score the missing scenes, then write the tables."""
    if request.models and not request.pretrained:
        raise UsageError(
            "--task editing trains nothing; add --pretrained for weights that ship with the package, or give a folder "
            "of your own with --checkpoint in the place of --model."
        )
    if idle := [model for model in request.models if find_model(model).kind != "learned"]:
        raise UsageError(f"{idle[0]!r} infers no scenes that could be edited; leave it out.")
    sources = [_with_edits(source) for source in request.sources]
    jobs = [job for source in sources for job in _jobs(request, source, values)]
    remove_abandoned(values.out, recursive=True)
    _make_room(jobs, overwrite=values.overwrite)
    prepare(dict.fromkeys(sources, (SPLIT,)), workers=values.workers)
    reasons = _run([job for job in jobs if job.missing()], values)
    console = wide_console()
    console.print(summary.screen_table(summary.write(values.out)))
    console.print()
    print_path(console, "Table: ", values.out / summary.FILES[1])
    return EXIT_INCOMPLETE if reasons else EXIT_OK


def _with_edits(source: Source) -> Source:
    """Add all edits to a track; check that a dataset has some."""
    if isinstance(source, Track):
        return replace(source, edits=EDITS)
    kinds_in(Dataset(source.folder))
    return source


def _jobs(request: Request, source: Source, values: arguments.Run) -> list[EditJob]:
    fit = request.fit_source or source
    there = source.size(SPLIT)
    if values.scenes is not None and values.scenes > there:
        raise UsageError(f"--scenes is {values.scenes}; expected at most {there}, the test scenes of {source.name}.")
    scenes = values.scenes or there
    answers: dict[str, Weights | None] = {REFERENCES: None}
    answers |= {weights.name: weights for weights in trained(request, fit)}
    return [
        EditJob(
            track=source.name,
            model=f"{model}{REFINED}" if weights and values.refine else model,
            data=source.folder,
            checkpoint=weights.folder if weights else None,
            refinements=values.refine,
            scenes=scenes,
            digest=digest({"facts": _facts(source, weights, values.refine)}),
            out=values.out,
        )
        for model, weights in answers.items()
    ]


def _facts(source: Source, weights: Weights | None, refinements: int) -> list[object]:
    """List the facts that determine the scores, for the job's digest."""
    if weights is None:
        return [VERSION, source.spec_hash, None]
    model = [find_model(weights.model).version, content_hash(weights.folder)]
    return [VERSION, source.spec_hash, *model, *([refinements] if refinements else [])]


def _make_room(jobs: Sequence[EditJob], *, overwrite: bool) -> None:
    """Delete old lines that would share a place with new ones but are of another model or another dataset."""
    for job in jobs:
        place = glob.escape(f"{job.track}--{job.model}--") + "????????.csv"
        for other in (path for path in (job.out / FOLDER).glob(place) if path != job.path):
            if not overwrite:
                raise UsageError(
                    f"{other} has edits by another version of the model, of other weights, of another dataset of that "
                    "name, or with another --refine. Give another folder with --out, or --overwrite to replace them."
                )
            other.unlink()


def _run(jobs: Sequence[EditJob], values: arguments.Run) -> list[str]:
    """Run the jobs in parallel, and print a line for each; returns the reasons of failures."""
    console, reasons = status_console(), []
    limits = job_limits(values, GRACE_SECONDS)
    with progress_bar(console, "scenes", sum(len(job.missing()) for job in jobs)) as advance:

        def on_event(job: EditJob, event: str) -> None:
            if event == job.name:
                console.print(terminal(f"{job.track}, {job.model}: {counted(job.scenes, 'scene')}"))
            else:  # a scene
                advance()

        def on_failure(job: EditJob, outcome: Outcome) -> list[EditJob]:
            console.print(terminal(f"{job.track}, {job.model}: FAILED, {outcome.reason}"))
            reasons.append(outcome.reason)
            return []

        with places(values, jobs) as workers:
            run_jobs(jobs, lambda job: limits, workers, on_event=on_event, on_failure=on_failure)
    return reasons
