"""How like real scenes sampled ones are: to segmenters that know the real ones, by sizes and colours, and to the eye.

python -m benchmark.studies.creation.samples_cli --track moving --picture docs/images/sampled_moving.png
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark.metrics.kernel_distance import KernelDistance, kernel_distance
from benchmark.models.adapters.learned import LearnedSegmenter
from benchmark.models.interface import Segmenter
from benchmark.models.registry import find_model
from benchmark.models.tuning import choose
from benchmark.ranking.leaderboard import Cell, Line
from benchmark.studies.claims.command import run_command
from benchmark.studies.creation.sampled import Labelled, Looks, looks, mean_ari_fg, real_scenes, sampled_scenes
from benchmark.studies.creation.subject import Subject
from datagen.errors import EXIT_OK, UsageError
from datagen.storage.reader import Dataset
from obpose.scenes.model_ref import Origin, load_origin
from obpose.scenes.pictures import enlarged, write_png
from obpose.scenes.priors import available_priors, load_prior
from obpose.scenes.priors.interface import ScenePrior
from obpose.storage.pretrained import shipped_names

PROGRAM = "python -m benchmark.studies.creation.samples_cli"
TUNED_ON = "val"
SEGMENTS = "obpose"
"""Whose weights segment, as those of `obpose-sharp` sample."""
OURS, CLUSTERING = "ObPose", "plane-hdbscan"
FEATURES = ("size", "colour")
COLUMNS, TILE, GAP = 10, 96, 2
"""Of the picture: scenes a row, least pixels a scene, white pixels between."""


@dataclass(frozen=True)
class Arguments(Subject):
    """Options of the command."""

    seed: int = 0
    """Of the samples."""
    segmenter: str = ""
    """Folder of a trained model, or the name of weights that ship, to segment the scenes with: other weights than those
    that sample. By default those of `obpose` that ship for the track, or the sampling ones where there are none."""
    picture: Path | None = None
    """PNG to write: real scenes, beneath them some of the flow where there is one, of the fitted prior, and of the
    learned one."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and draw; give the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """Of one model and dataset."""
    values.check(scenes=1, seed=0)
    origin = values.origin()
    segmenter = load_origin(values.segmenter or shipped_to_segment(values.source.name) or origin.name)
    if values.picture is not None and values.picture.suffix != ".png":
        raise UsageError(f"--picture {values.picture}: expected a name that ends with .png.")
    if values.split == TUNED_ON:
        raise UsageError(
            f"--split {TUNED_ON}: real scenes are compared with those of {TUNED_ON}; expected test or train."
        )
    dataset = Dataset(values.folder((TUNED_ON,)))
    real, others = (real_scenes(dataset.split(name), values.scenes) for name in (values.split, TUNED_ON))
    kinds = {f"real ({values.split})": real, f"real ({TUNED_ON})": others}
    for name, source in _sources(origin):
        kinds[f"sampled, {name}"] = list(sampled_scenes(origin, source, real, seed=values.seed))
    print(f"{origin.name}, {len(real)} scenes of {values.source.name}, first view and frame, seed {values.seed}:\n")
    print(f"{OURS} segments with {segmenter.name}{_circular(origin, segmenter)}.\n")
    segmenters = {OURS: _model(segmenter), CLUSTERING: _clustering(others, values.source.slots)}
    measured = list(lines(kinds, segmenters, values.seed))
    for row in table(measured):
        print(row)
    values.write_csv(origin, [{"segmenter": segmenter.name, **line} for line in measured])
    if values.picture is not None:
        rows = [kind for name, kind in kinds.items() if name != f"real ({TUNED_ON})"]
        write_png(values.picture, grid(rows))
        print(values.picture)
    return EXIT_OK


def _sources(origin: Origin) -> Iterator[tuple[str, ScenePrior]]:
    for name in available_priors(origin):
        yield f"prior {name}", load_prior(origin, name)


def shipped_to_segment(track: str) -> str | None:
    """Name of the weights of `obpose` that ship for a track, if there are any."""
    return next((name for name in shipped_names() if name.startswith(f"{SEGMENTS}--{track}--")), None)


def _circular(origin: Origin, segmenter: Origin) -> str:
    same = origin.hash == segmenter.hash
    return ", the weights that sample: what they draw they also recognise" if same else ""


def grid(rows: Sequence[Sequence[Labelled]]) -> np.ndarray:
    """Images in rows, each enlarged by a whole number."""
    lines = []
    for scenes in rows:
        images = [scene.clip.rgb[0, 0] for scene in scenes[:COLUMNS]]
        tiles = [enlarged(image, max(1, TILE // image.shape[0])) for image in images]
        lines.append(np.concatenate([_framed(tile) for tile in tiles], axis=1))
    return np.concatenate(lines)


def _framed(tile: np.ndarray) -> np.ndarray:
    return np.pad(tile, ((GAP, GAP), (GAP, GAP), (0, 0)), constant_values=255)


def _model(origin: Origin) -> Segmenter:
    model = LearnedSegmenter("obpose", slots=origin.model.config.model.slots + 1, checkpoint=origin.folder)
    model.fit([], [], seed=0, budget=0.0)
    return model


def _clustering(scenes: Sequence[Labelled], slots: int) -> Segmenter:
    """Tuned on these."""
    spec = find_model(CLUSTERING)
    clips, labels = [scene.clip for scene in scenes], [scene.labels for scene in scenes]
    chosen = choose(spec, {"slots": slots}, [], clips, labels, seed=0, budget=0.0).options
    segmenter = spec.build(chosen)
    segmenter.fit([], clips, seed=0, budget=0.0)
    return segmenter


def lines(kinds: Mapping[str, Sequence[Labelled]], segmenters: Mapping[str, Segmenter], seed: int) -> Iterator[Line]:
    """One for each kind of scenes, distances being those from the first."""
    (first, real), *_ = kinds.items()
    seen = looks(real)
    for name, scenes in kinds.items():
        found = looks(scenes)
        line: dict[str, Cell] = {"scenes": name, "seed": seed, "objects": len(found.scene)}
        line |= {f"ari_fg {segmenter}": mean_ari_fg(model, scenes) for segmenter, model in segmenters.items()}
        for feature in FEATURES if name != first else ():
            if distance := _distance(feature, found, seen, seed):
                line |= {f"mmd2 {feature}": distance.squared, f"mmd2 {feature} p": distance.p_value}
        yield line


def table(measured: Sequence[Line]) -> Iterator[str]:
    """As Markdown."""
    first = measured[0]["scenes"]
    distances = [f"MMD² of {feature} from {first} (p)" for feature in FEATURES]
    yield f"| scenes | objects | ARI-FG of {OURS} | ARI-FG of {CLUSTERING} | {' | '.join(distances)} |"
    yield f"|---|{'---:|' * (3 + len(distances))}"
    for line in measured:
        cells = [f"{line[f'ari_fg {name}']:.3f}" for name in (OURS, CLUSTERING)]
        cells += ["" if line["scenes"] == first else _cell(line, feature) for feature in FEATURES]
        yield f"| {line['scenes']} | {line['objects']} | {' | '.join(cells)} |"


def _distance(feature: str, one: Looks, other: Looks, seed: int) -> KernelDistance | None:
    """None where there is no more than an object to compare."""
    if min(len(one.scene), len(other.scene)) < 2:
        return None
    values = (getattr(one, feature), getattr(other, feature))
    return kernel_distance(*values, one.scene, other.scene, rng=np.random.default_rng(seed))


def _cell(line: Line, feature: str) -> str:
    squared = line.get(f"mmd2 {feature}")
    return "–" if squared is None else f"{squared:z.4f} ({line[f'mmd2 {feature} p']:.3f})"


if __name__ == "__main__":
    raise SystemExit(main())
