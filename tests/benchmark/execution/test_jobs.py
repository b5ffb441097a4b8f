import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmark.execution.executor import Limits
from benchmark.execution.jobs import Job, Target, run_all
from benchmark.models import registry
from benchmark.models.contract import BadPrediction
from benchmark.models.interface import Clip, Prediction
from benchmark.models.model_spec import ModelSpec, Options, Views
from benchmark.models.registry import find_model
from benchmark.ranking.standings import pooled
from benchmark.results import reconstructions
from benchmark.results.labels import read_labels
from benchmark.results.run_folder import LABELS, RunKey, load_runs, load_scenes
from datagen.errors import UsageError
from datagen.storage import reader
from datagen.storage.reader import Dataset
from tests.processes import in_this_process
from tests.worlds.imported import import_balls
from tests.worlds.traced import write_dataset

Answer = Callable[[Clip], Prediction]


class Scripted:
    """A model that answers as it is told, and remembers what it was given."""

    fits: list[tuple[int, int, int, float]]

    def __init__(self, answer: Answer):
        self.answer = answer
        self.options: list[Options] = []
        self.fits = []

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        self.fits.append((len(train), len(val), seed, budget))

    def segment(self, clip: Clip) -> Prediction:
        return self.answer(clip)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "data", scenes=2, frames=3, views=2, sensor=True)


@pytest.fixture
def register(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Scripted]:
    def add(answer: Answer, **facts: object) -> Scripted:
        model = Scripted(answer)

        def build(options: Options) -> Scripted:
            model.options.append(dict(options))
            return model

        monkeypatch.setitem(registry.MODELS, "scripted", ModelSpec(build=build, version=3, description="", **facts))
        return model

    return add


def job(data: Path, out: Path, *more: Path, **changes: object) -> Job:
    targets = [
        Target(RunKey(folder.name, data.name, "scripted", 4, 3, "c", "f", str(folder)), folder, slots=5 + number)
        for number, folder in enumerate((data, *more))
    ]
    made = Job("scripted", 4, fit_data=data, fit_slots=5, targets=tuple(targets), out=out, seconds=10.0)
    return dataclasses.replace(made, **changes)


def background(clip: Clip) -> Prediction:
    return Prediction(np.zeros(clip.depth.shape, np.int64), 0)


def test_a_model_that_knows_the_truth_scores_one(data: Path, tmp_path: Path, register):
    truths = iter([reader.Dataset(data).split("test")[i]["segmentation"] for i in range(2)])
    model = register(lambda clip: Prediction(next(truths).astype(np.int64), 0))
    events = []
    job(data, tmp_path / "out").run(events.append)
    (row,) = load_runs(tmp_path / "out")
    assert events == ["fitted", row.key.name]
    assert model.fits == [(2, 2, 4, 10.0)]
    assert (row.status, row.reason, row.n_scenes, row.tuned, row.trials) == ("ok", "", 2, False, 0)
    assert row.config == {"slots": 5}
    assert row.measured.seconds_per_frame > 0
    table = load_scenes(tmp_path / "out", row)
    assert table["n_frames"].tolist() == [6, 6]
    assert all(pooled(table, name) == 1 for name in ("ari", "ari_fg", "msc_fg", "miou_bg"))


def test_pixels_without_depth_do_not_count(data: Path, tmp_path: Path, register):
    scenes = reader.Dataset(data).split("test")
    truths = iter([scenes[i]["segmentation"] for i in range(2)])
    register(lambda clip: Prediction(np.where(clip.valid, next(truths), 9).astype(np.int64), 0))
    job(data, tmp_path / "out").run()
    table = load_scenes(tmp_path / "out", load_runs(tmp_path / "out")[0])
    assert pooled(table, "ari") == pooled(table, "msc_fg") == 1
    assert table["ignored"].tolist() == [np.sum(scenes[i]["sensor_valid"] == 0) for i in range(2)]


def test_the_largest_slot_stands_in_for_an_undeclared_background(data: Path, tmp_path: Path, register):
    register(
        lambda clip: Prediction(np.where(np.arange(clip.depth.shape[-1]) < 8, 1, 6) + 0 * clip.depth.astype(int), None)
    )
    job(data, tmp_path / "out").run()
    (path,) = (tmp_path / "out" / LABELS).iterdir()
    assert {slot for _, slot in read_labels(path)} == {6}


@pytest.mark.parametrize(("uses_labels", "kind"), [(False, "learned"), (True, "oracle"), (True, "learned")])
def test_clips_carry_labels_for_those_only_who_say_so(
    data: Path, tmp_path: Path, register, uses_labels: bool, kind: str
):
    seen: dict[str, list[bool]] = {"train": [], "val": [], "test": []}

    def answer(clip: Clip) -> Prediction:
        seen["test"].append(clip.truth is not None)
        return background(clip)

    def fit(train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        for split, clips in (("train", train), ("val", val)):
            seen[split] += [clip.truth is not None for clip in clips]

    register(answer, uses_labels=uses_labels, kind=kind).fit = fit
    job(data, tmp_path / "out").run()
    assert seen == {"train": [uses_labels] * (2 if kind == "learned" else 0)} | dict.fromkeys(
        ("val", "test"), [uses_labels] * 2
    )
    assert load_runs(tmp_path / "out")[0].uses_labels is uses_labels


def test_validation_scores_stand_in_the_learning_curve(data: Path, tmp_path: Path, register):
    truth = reader.Dataset(data).split("val")[0]["segmentation"].astype(np.int64)
    model = register(background)

    def fit(train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        assert all(clip.truth is None for clip in val)
        model.options[-1]["watch"](lambda clip: Prediction(truth, 0), step=7, seconds=30.0)
        model.learning_curve = [{"step": 3, "loss": np.float32(2.0)}, {"step": 7, "loss": np.float32(1.0)}]

    model.fit = fit
    job(data, tmp_path / "out", folder=tmp_path / "out" / "training" / "own").run()
    first, last = load_runs(tmp_path / "out")[0].learning_curve or []
    assert first == {"step": 3.0, "loss": 2.0}
    assert last.keys() == {"step", "seconds", "loss", "ari_fg", "msc_fg"}
    assert last["msc_fg"] > 0


@pytest.mark.parametrize(
    ("facts", "changes", "options", "config"),
    [
        ({}, {"steps": 12}, {"steps": 12}, {"steps": 12}),
        ({"settings": {"model": {"width": 64}}}, {}, {}, {"model": {"width": 64}}),
        (
            {"settings": {"width": 1}, "profiles": {"gpu": {"width": 2}}},
            {"profile": "gpu"},
            {"profile": "gpu"},
            {"width": 2, "profile": "gpu"},
        ),
    ],
)
def test_options_reach_the_model_and_settings_its_row(
    data: Path, tmp_path: Path, register, facts, changes, options, config
):
    model = register(background, **facts)
    job(data, tmp_path / "out", **changes).run()
    assert model.options == [{"slots": 5, **options}]
    assert load_runs(tmp_path / "out")[0].config == {"slots": 5, **config}


def test_models_that_learn_nothing_get_no_training_clips(data: Path, tmp_path: Path, register):
    for path in data.glob("train-*.h5"):
        path.unlink()
    model = register(background, kind="classical")
    job(data, tmp_path / "out").run()
    assert model.fits == [(0, 2, 4, 10.0)]


def test_tuning_takes_half_of_the_budget_and_is_recorded(data: Path, tmp_path: Path, register):
    model = register(background, grid=({"reach": 1}, {"reach": 2}))
    job(data, tmp_path / "out").run()
    (row,) = load_runs(tmp_path / "out")
    assert (row.tuned, row.trials) == (True, 2)
    assert row.config == {"slots": 5, "reach": 1}
    assert [budget for *_, budget in model.fits] == [2.5, 2.5, 5.0]


def test_one_fit_serves_all_targets(data: Path, tmp_path: Path, register):
    other = write_dataset(tmp_path / "other", scenes=1, frames=1)
    model = register(background, kind="learned")
    job(data, tmp_path / "out", other).run()
    assert len(model.fits) == 1
    assert {row.key.track: row.n_scenes for row in load_runs(tmp_path / "out")} == {"data": 2, "other": 1}


def test_models_that_learn_nothing_get_each_track_s_slots(data: Path, tmp_path: Path, register):
    other = write_dataset(tmp_path / "other", scenes=1, frames=1)
    model = register(background, kind="classical")
    job(data, tmp_path / "out", other).run()
    assert [options["slots"] for options in model.options] == [5, 6]


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda clip: Prediction(np.zeros(clip.depth.shape[1:], int), 0), "of shape"),
        (lambda clip: Prediction(np.full(clip.depth.shape, np.nan), 0), "with nan"),
        (lambda clip: Prediction(np.full(clip.depth.shape, 256), 0), "slot 256"),
        (lambda clip: Prediction(np.zeros(clip.depth.shape, int), -1), "slot -1"),
        (lambda clip: None, "NoneType"),
    ],
)
def test_a_model_that_breaks_the_contract_is_named(data: Path, tmp_path, register, answer, message: str):
    register(answer)
    with pytest.raises(BadPrediction, match=message):
        job(data, tmp_path / "out").run()
    assert [path for path in (tmp_path / "out").rglob("*") if path.is_file()] == []


def test_an_empty_split_is_refused(tmp_path: Path, register):
    register(background)
    empty = write_dataset(tmp_path / "empty", scenes=0)
    with pytest.raises(UsageError, match="has no scenes"):
        job(empty, tmp_path / "out").run()
    register(background, grid=({"reach": 1}, {"reach": 2}))
    with pytest.raises(UsageError, match="no validation scenes"):
        job(empty, tmp_path / "out").run()


def both(clip: Clip) -> Prediction:
    labels = np.zeros(clip.depth.shape, np.int64)
    return Prediction(labels, 0, {"att": labels + 1})


def with_extra(made: Job) -> Job:
    targets = [
        dataclasses.replace(target, extra={"att": dataclasses.replace(target.key, model="scripted-att")})
        for target in made.targets
    ]
    return dataclasses.replace(made, targets=tuple(targets))


def test_further_segmentations_have_rows_of_their_own(data: Path, tmp_path: Path, register):
    model = register(both, extra=("att",))
    model.learning_curve = [{"step": 1, "loss": 0.5}]
    events = []
    with_extra(job(data, tmp_path / "out")).run(events.append)
    main, other = load_runs(tmp_path / "out")
    assert (main.key.model, other.key.model) == ("scripted", "scripted-att")
    assert events == ["fitted", main.key.name]
    assert (main.learning_curve, other.learning_curve) == ([{"step": 1.0, "loss": 0.5}], None)
    assert len(model.fits) == 1
    maps = {path.name.split("--")[1]: path for path in (tmp_path / "out" / LABELS).iterdir()}
    assert {name: {int(labels.max()) for labels, _ in read_labels(path)} for name, path in maps.items()} == {
        "scripted": {0},
        "scripted-att": {1},
    }
    tables = [load_scenes(tmp_path / "out", row) for row in (main, other)]
    assert pooled(tables[0], "miou_bg") > pooled(tables[1], "miou_bg")


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("extra", "message"), [({}, "no 'att' in `extra`"), ({"att": np.full((3, 2, 4, 4), 0)}, "of shape")]
)
def test_a_further_segmentation_that_is_missing_or_wrong_is_named(
    data: Path, tmp_path: Path, register, extra, message: str
):
    register(lambda clip: Prediction(background(clip).labels, 0, extra), extra=("att",))
    with pytest.raises(BadPrediction, match=message):
        with_extra(job(data, tmp_path / "out")).run()


def test_a_failure_is_a_row_of_every_segmentation(data: Path, tmp_path: Path, register):
    register(background, extra=("att",))
    heard = []
    with in_this_process():
        run_all([with_extra(job(data, tmp_path / "out"))], lambda _: Limits(60.0, 4000.0), 1, heard.append)
    assert [(row.key.model, row.status) for row in heard] == [("scripted", "failed")]
    rows = load_runs(tmp_path / "out")
    assert [(row.key.model, row.status) for row in rows] == [("scripted", "failed"), ("scripted-att", "failed")]
    assert all("no 'att' in `extra`" in row.reason for row in rows)


def test_a_folder_is_offered_for_the_fit_that_counts_and_kept_out_of_the_row(data: Path, tmp_path: Path, register):
    model = register(background, grid=({"reach": 1}, {"reach": 2}))
    job(data, tmp_path / "out", folder=tmp_path / "own").run()
    assert ["folder" in options for options in model.options] == [False, False, True]
    assert model.options[-1]["folder"] == tmp_path / "own"
    assert "folder" not in load_runs(tmp_path / "out")[0].config


def test_a_run_that_went_on_says_how_long_fitting_took_in_all(data: Path, tmp_path: Path, register):
    register(background).fit_seconds = 1000.0
    job(data, tmp_path / "out").run()
    assert load_runs(tmp_path / "out")[0].measured.fit_seconds == 1000.0


def test_what_a_model_was_fitted_with_counts_more_than_what_it_declares(data: Path, tmp_path: Path, register):
    register(background, settings={"minutes": 23}).fitted_settings = {"minutes": 12}
    job(data, tmp_path / "out").run()
    assert load_runs(tmp_path / "out")[0].config == {"minutes": 12, "slots": 5}


def test_weights_that_were_trained_before_need_no_clips(data: Path, tmp_path: Path, register):
    for path in [*data.glob("train-*.h5"), *data.glob("val-*.h5")]:
        path.unlink()
    model = register(background)
    job(data, tmp_path / "out", checkpoint=tmp_path / "scripted--data--64x48").run()
    assert model.options == [{"slots": 5, "checkpoint": tmp_path / "scripted--data--64x48"}]
    assert model.fits == [(0, 0, 4, 0.0)]
    assert load_runs(tmp_path / "out")[0].pretrained == "scripted--data--64x48"


def test_rows_of_weights_state_what_these_were_trained_with(data: Path, tmp_path: Path, register):
    def own(folder: Path) -> ModelSpec:
        assert folder.name == "mine"
        return dataclasses.replace(find_model("scripted"), priors=("slots",), views=Views("all", "all"))

    register(background, priors=("plane",), views=Views("one", "all"), configured=own)
    job(data, tmp_path / "out", checkpoint=tmp_path / "mine").run()
    (row,) = load_runs(tmp_path / "out")
    assert (row.priors, row.views) == (("slots",), "2 in, 2 supervise")


def test_what_a_model_changes_on_a_track_reaches_it_and_its_row(data: Path, tmp_path: Path, register):
    elsewhere = register(background, kind="learned", on_tracks={"other": {"size": 2}})
    job(data, tmp_path / "out").run()
    there = register(background, kind="learned", on_tracks={data.name: {"size": 2}})
    job(data, tmp_path / "again").run()
    assert "changes" not in elsewhere.options[-1]
    assert there.options[-1]["changes"] == {"size": 2}
    (row,) = load_runs(tmp_path / "again")
    assert row.config["changes"] == {"size": 2}


def changeable(register: Callable[..., Scripted], **facts: object) -> list[dict[str, object]]:
    """Register a model that appends the changes which it gets to a list."""
    model, changes = register(background, kind="learned", **facts), []

    def with_changes(change: dict[str, object]) -> Scripted:
        changes.append(change)
        return model

    model.with_changes = with_changes
    return changes


def test_a_model_is_changed_on_the_tracks_that_ask_for_it_and_fitted_once(data: Path, tmp_path: Path, register):
    other = write_dataset(tmp_path / "other", scenes=1, frames=2)
    changes = changeable(register, at_test={"other": {"bias": 2}})
    job(data, tmp_path / "out", other).run()
    assert changes == [{"bias": 2}]
    assert len(find_model("scripted").build({}).fits) == 1


def test_weights_that_are_given_keep_their_settings(data: Path, tmp_path: Path, register):
    changes = changeable(register, at_test={data.name: {"bias": 2}})
    job(data, tmp_path / "out", checkpoint=tmp_path / "mine").run()
    assert changes == []


def test_a_model_is_not_tuned_on_scenes_without_masks(tmp_path: Path, register):
    folder = import_balls(tmp_path, masks=("test",)).folder
    register(background)
    job(folder, tmp_path / "out").run()
    register(background, grid=({"reach": 1}, {"reach": 2}))
    with pytest.raises(UsageError, match="no masks in split val"):
        job(folder, tmp_path / "out").run()


class Renderer(Scripted):
    """A model that renders what it is told to."""

    def __init__(self, picture: np.ndarray | None):
        super().__init__(background)
        self.picture, self.asked = picture, []

    def reconstruct_images(self, clip: Clip, images: Sequence[tuple[int, int]]) -> np.ndarray | None:
        self.asked.append(list(images))
        return None if self.picture is None else np.stack([self.picture] * len(images))


@pytest.mark.parametrize("renders", [True, False])
def test_a_few_scenes_are_rendered_by_models_that_can(data: Path, tmp_path: Path, monkeypatch, *, renders: bool):
    model = Renderer(np.full((48, 64, 3), 100, np.uint8) if renders else None)
    monkeypatch.setitem(registry.MODELS, "scripted", ModelSpec(build=lambda options: model, version=3, description=""))
    job(data, tmp_path / "out").run()
    assert model.asked == []  # not for seeds that the report does not show
    job(data, tmp_path / "out", seed=0).run()
    scenes = reconstructions.shown_scenes(len(Dataset(data).split("test")))
    assert model.asked == [reconstructions.shown_images(3, 2)] * (len(scenes) if renders else 1)
    found = sorted(path.name for path in (tmp_path / "out").rglob("*.webp"))
    assert found == ([f"{scene:05d}.webp" for scene in scenes] if renders else [])
    assert load_runs(tmp_path / "out")[0].status == "ok"


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((48, 64, 3)),
        np.zeros((48, 64, 4), np.uint8),
        np.zeros((48, 65, 3), np.uint8),
        np.zeros((0, 64, 3), np.uint8),
        np.zeros((48, 64), np.uint8),
    ],
)
def test_pictures_of_the_wrong_kind_are_refused(data: Path, tmp_path: Path, monkeypatch, picture: np.ndarray):
    spec = ModelSpec(build=lambda options: Renderer(picture), version=3, description="")
    monkeypatch.setitem(registry.MODELS, "scripted", spec)
    with pytest.raises(BadPrediction, match=r"In scene 0 the model gave a reconstruction .*; expected uint8"):
        job(data, tmp_path / "out", seed=0).run()
