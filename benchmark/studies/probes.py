"""Linear probes of z_what: which of shape, colour and size can be read from the objects' latents.

Position is probed as well, which the latent should not hold. Each probe is compared with one of T_hat, and with the
best answer without input.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from sklearn.linear_model import LogisticRegression, RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from benchmark.ranking.leaderboard import Line
from benchmark.ranking.statistics import interval
from benchmark.studies.inputs import ModelFlags, TableFlags, first_clips, matched_slots
from datagen.errors import UsageError
from datagen.geometry import rotation_from_quaternion
from datagen.schema import SceneRecord
from obpose.data.clips import select_part
from obpose.data.resolution import fitting_model
from obpose.scenes.model_ref import Origin

TRAINED_ON = "train"
LEAST_OBJECTS = 20
"""Number of objects below which probes say nothing."""
LEAST_HEIGHT = 0.001
"""Standard deviation of residual heights, metres, below which they are not probed."""
MOST_COLOURS = 16
"""Number of colours up to which they are also probed as names."""
ALPHAS = 10.0 ** np.arange(-3, 5)
"""Strengths of ridge regression, chosen by leave-one-out on the training objects."""
MOST_STEPS = 2000
RESAMPLES = 1000

Pair = tuple[np.ndarray, np.ndarray]
"""Arrays of the training objects and of the tested ones."""


@dataclass(frozen=True, kw_only=True)
class Flags(ModelFlags, TableFlags):
    """Options of the study."""

    learn_scenes: int = 400
    """Number of training scenes on whose objects the probes are trained."""


@dataclass(frozen=True, eq=False)
class Objects:
    """Objects matched by slots: latents and ground truth of one frame each."""

    scene: Int[np.ndarray, "object"]
    what: Float[np.ndarray, "object latent"]
    """Posterior mean of z_what."""
    place: Float[np.ndarray, "object 3"]
    """T_hat, metres, world frame."""
    shape: np.ndarray
    """Name in the catalogue, text."""
    colour: Float[np.ndarray, "object 3"]
    """First colour, sRGB from 0 to 1."""
    plain: np.ndarray
    """Whether it has one colour only, bool."""
    size: Float[np.ndarray, "object"]
    """Edge of the cube with the volume of the object's box, metres."""
    position: Float[np.ndarray, "object 3"]
    """Centre of the object's box, metres, world frame."""
    missed: int
    """Number of objects in view that no slot matches in any frame."""


@dataclass(frozen=True)
class Probe:
    """Scores of a probe on held-out objects."""

    score: float
    """R² of numbers, accuracy of names."""
    low: float
    """95 % interval over scenes."""
    high: float
    baseline: float
    """Score of the answer without input: the mean, or the most frequent name, of the training objects."""


def run(flags: Flags) -> list[Line]:
    """Score all probes.

    Raises:
        UsageError: the probes would be tested on the split they are trained on, or there are too few objects.
    """
    flags.check(scenes=1, learn_scenes=1)
    if flags.split == TRAINED_ON:
        raise UsageError(f"--split {TRAINED_ON}: probes are trained on it; expected val or test.")
    origin, folder = flags.origin(), flags.folder(TRAINED_ON)
    trained = infer_objects(origin, folder, TRAINED_ON, flags.learn_scenes)
    tested = infer_objects(origin, folder, flags.split, flags.scenes)
    print(
        f"{origin.name}: {len(trained.scene)} objects of {flags.learn_scenes} training scenes, {len(tested.scene)} of "
        f"{flags.scenes} scenes of the split {flags.split}; {tested.missed} more of these were not found.\n"
    )
    return list(probe(trained, tested))


def infer_objects(origin: Origin, folder: Path, split: str, scenes: int) -> Objects:
    """Infer the objects of the first scenes of a split from the first view.

    Of the frames in which an object is matched, the middle one is used.

    Raises:
        UsageError: there are too few objects.
    """
    rows, missed = [], 0
    for index, (record, every) in enumerate(first_clips(folder, split, scenes)):
        observation = select_part(every, views=slice(1))
        found = fitting_model(origin.model, observation).segment(observation)
        what, place = (
            values[0].numpy().astype(np.float64) for values in (found.inference.what.z, found.inference.boxes.center)
        )
        truth = record["segmentation"][:, 0]
        slots = matched_slots(truth, found.labels[0, :, 0].numpy())
        matched = [row for row in range(slots.shape[1]) if (slots[:, row] >= 0).any()]
        missed += len(set(np.unique(truth)) - {0}) - len(matched)
        for row in matched:
            frame = middle_frame(slots[:, row])
            at = (frame, slots[frame, row])
            rows.append({"scene": index, "what": what[at], "place": place[at], **true_properties(record, row, frame)})
    if len(rows) < LEAST_OBJECTS:
        raise UsageError(
            f"{len(rows)} objects of {split} were found; expected {LEAST_OBJECTS} or more. Give more scenes."
        )
    return Objects(missed=missed, **{name: np.array([row[name] for row in rows]) for name in rows[0]})


def middle_frame(slots: Int[np.ndarray, "frame"]) -> int:
    """Middle one of the frames in which an object has a slot."""
    frames = np.flatnonzero(slots >= 0)
    return int(frames[len(frames) // 2])


def true_properties(record: SceneRecord, row: int, frame: int) -> dict[str, object]:
    """Look up an object's ground truth."""
    rotation = rotation_from_quaternion(record["poses/quaternion_wxyz"][frame, row].astype(np.float64))
    middle = record["poses/position"][frame, row] + rotation @ record["objects/minimum_box_center"][row]
    return {
        "shape": bytes(record["objects/category"][row]).decode(),
        "colour": record["objects/color"][row, 0].astype(np.float64),
        "plain": bytes(record["objects/pattern"][row]).decode() == "plain",
        "size": float(np.prod(record["objects/minimum_box_size"][row], dtype=np.float64) ** (1 / 3)),
        "position": middle.astype(np.float64),
    }


def probe(trained: Objects, tested: Objects) -> Iterator[Line]:
    """Probe the latents for every property; for colour, only objects of one colour are used."""
    yield answer("shape", trained, tested, lambda objects: objects.shape)
    plain = _select(trained, trained.plain), _select(tested, tested.plain)
    if len(np.unique(plain[0].colour, axis=0)) <= MOST_COLOURS:
        yield answer("colour, of a palette", *plain, lambda objects: _colour_names(objects.colour))
    yield answer("colour", *plain, lambda objects: objects.colour)
    yield answer("size", trained, tested, lambda objects: objects.size)
    for axis, name in enumerate("xyz"):
        yield answer(f"position, {name}", trained, tested, lambda objects, axis=axis: objects.position[:, axis])
    residual = height_beyond_shape(trained)
    if residual(trained).std() >= LEAST_HEIGHT:
        yield answer("position, z, beyond shape and size", trained, tested, residual)


def answer(what: str, trained: Objects, tested: Objects, truth: Callable[[Objects], np.ndarray]) -> Line:
    """Probe z_what and T_hat for one property, given as names or as numbers."""
    values = truth(trained), truth(tested)
    is_name = values[0].dtype.kind == "U"
    latent, place = (
        (probe_names if is_name else probe_numbers)(inputs, values, tested.scene)
        for inputs in ((trained.what, tested.what), (trained.place, tested.place))
    )
    return {
        "what": what,
        "measure": "right" if is_name else "R²",
        "z_what": latent.score,
        "z_what_ci_low": latent.low,
        "z_what_ci_high": latent.high,
        "t_hat": place.score,
        "no_input": latent.baseline,
        "learned_from": len(trained.scene),
        "tested": len(tested.scene),
    }


def height_beyond_shape(trained: Objects) -> Callable[[Objects], Float[np.ndarray, "object"]]:
    """Residual of an object's height, metres, after a linear fit of height to size for each shape.

    Objects stand on the table, so the centres of larger ones are higher. A latent that holds shape and size therefore
    holds that part of the height.
    """
    kinds = np.unique(trained.shape)

    def known(objects: Objects) -> Float[np.ndarray, "object number"]:
        is_kind = (objects.shape[:, None] == kinds).astype(float)
        return np.concatenate([is_kind, is_kind * objects.size[:, None]], axis=1)

    slopes, *_ = np.linalg.lstsq(known(trained), trained.position[:, 2], rcond=None)
    return lambda objects: objects.position[:, 2] - known(objects) @ slopes


def probe_numbers(inputs: Pair, values: Pair, scene: Int[np.ndarray, "object"]) -> Probe:
    """Probe with ridge regression; several numbers share one R², from their summed squared errors.

    Args:
        inputs: Features of the training and of the tested objects.
        values: Numbers to be predicted.
        scene: Scenes of the tested objects.
    """
    model = make_pipeline(StandardScaler(), RidgeCV(ALPHAS)).fit(inputs[0], values[0])
    count = len(inputs[1])
    truth = values[1].reshape(count, -1).astype(np.float64)
    mean = np.broadcast_to(values[0].mean(axis=0), values[1].shape)
    wrong, wrong_mean = (
        np.sum((truth - answer.reshape(count, -1)) ** 2, axis=1) for answer in (model.predict(inputs[1]), mean)
    )
    spread = np.sum((truth - truth.mean(axis=0)) ** 2, axis=1)
    baseline = float(1 - wrong_mean.sum() / spread.sum())
    return _with_interval(lambda part: 1 - wrong[part].sum() / spread[part].sum(), baseline, scene)


def probe_names(inputs: Pair, values: Pair, scene: Int[np.ndarray, "object"]) -> Probe:
    """Probe with logistic regression; arguments as in `probe_numbers`, with names as values."""
    model = make_pipeline(StandardScaler(), LogisticRegression(max_iter=MOST_STEPS)).fit(inputs[0], values[0])
    right = model.predict(inputs[1]) == values[1]
    known, counts = np.unique(values[0], return_counts=True)
    baseline = float(np.mean(values[1] == known[np.argmax(counts)]))
    return _with_interval(lambda part: right[part].mean(), baseline, scene)


def _with_interval(score: Callable[[np.ndarray], float], baseline: float, scene: np.ndarray) -> Probe:
    """Score all objects, with a bootstrap interval over scenes."""
    rng = np.random.default_rng(0)
    members = [np.flatnonzero(scene == one) for one in np.unique(scene)]
    drawn = [
        score(np.concatenate([members[i] for i in rng.integers(len(members), size=len(members))]))
        for _ in range(RESAMPLES)
    ]
    return Probe(float(score(np.arange(len(scene)))), *interval(np.array(drawn)), baseline)


def _select(objects: Objects, kept: np.ndarray) -> Objects:
    arrays = {field.name: getattr(objects, field.name) for field in fields(objects) if field.name != "missed"}
    return replace(objects, **{name: array[kept] for name, array in arrays.items()})


def _colour_names(colours: Iterable[np.ndarray]) -> np.ndarray:
    return np.array([" ".join(f"{channel:.3f}" for channel in colour) for colour in colours])
