import signal
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import torch

from obpose.baselines.supervised import Supervised
from obpose.config import override
from obpose.contact.clip import Image
from obpose.contact.config import ContactConfig, OgcConfig, SupervisedConfig, check_contact_bounds
from obpose.contact.model import EMBEDDING, ContactModel, Outputs, Teacher
from obpose.contact.pasting import ClipsWithPasted, PastedClips, PseudoScene
from obpose.contact.scene_model import build_contact_obpose
from obpose.contact.self_training import DIVISION_BIAS, START, divided
from obpose.data.clips import ArrayClips, ClipSource
from obpose.errors import Interrupted, UsageError
from obpose.systems import find_system
from obpose.training.loop import Status, train
from tests.obpose.contact.test_grouping import affinities
from tests.worlds.sphere_clips import balls

PLACES = np.array([[[-0.1, 0.05, 0.045], [0.08, -0.1, 0.045]]])
SETTINGS = {"table": 0.0, "floor": 0.0015, "gap": 0.06, "clean": False, "seed": 0}
CONFIG = override(ContactConfig(), {"model.self_training": True})
EVERYWHERE = -20.0
"""Bias that divides objects everywhere."""


@pytest.fixture(autouse=True)
def divide_everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("obpose.contact.model.DIVISION_BIAS", EVERYWHERE)


@pytest.fixture(scope="module")
def clips() -> ArrayClips:
    return ArrayClips([balls(PLACES)[0], balls(PLACES * [1, -1, 1])[0]])


class Halves:
    """Divides every object into its upper and its lower half."""

    def __init__(self):
        self.asked = 0

    def __call__(self, scene: PseudoScene) -> np.ndarray:
        self.asked += 1
        rows = np.indices(scene.labels.shape)[0]
        middle = [rows[scene.labels == name].mean() for name in range(1, scene.count + 1)]
        lower = rows > np.array([0, *middle])[scene.labels]
        return np.where(scene.labels > 0, 2 * scene.labels - 1 + lower, 0).astype(np.uint8)


def labels(*rows: str) -> np.ndarray:
    return np.array([[int(each) for each in row] for row in rows])


def test_objects_are_divided_where_the_other_labelling_divides_them():
    mine = labels("1110", "1110", "0222", "0222").astype(np.uint8)
    other = labels("7750", "7750", "0550", "0555")
    found = divided(mine, other, least=2)
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, labels("2210", "2210", "0333", "0333"))


def test_small_pieces_and_background_join_the_nearest_larger_piece():
    mine = labels("111111111").astype(np.uint8)
    np.testing.assert_array_equal(divided(mine, labels("222030444"), least=3), labels("111112222"))
    np.testing.assert_array_equal(divided(mine, labels("222030440"), least=3), labels("111111111"))


def test_objects_of_which_all_pieces_are_small_stay_whole():
    mine = labels("1112222").astype(np.uint8)
    np.testing.assert_array_equal(divided(mine, labels("2304444"), least=3), mine)


@pytest.mark.parametrize("count", [255, 256])
def test_objects_stay_as_they_are_if_there_would_be_too_many(count: int):
    mine = np.repeat(np.arange(1, 129), 2)[None, :count].astype(np.uint8)
    found = divided(mine, np.arange(1, count + 1)[None], least=1)
    assert int(found.max()) == (255 if count == 255 else 128)


def test_the_pseudo_objects_of_each_clip_are_divided_once(clips: ArrayClips):
    before, halves = PastedClips(clips, **SETTINGS), Halves()
    counts = [int(before.window(0, start, 1)["pseudo_labels"].max()) for start in range(4)]
    after = before.divided_by(halves)
    more = [int(after.window(0, start, 1)["pseudo_labels"].max()) for start in range(4)]
    assert (before.divided, after.divided, halves.asked) == (False, True, len(clips))
    assert min(counts) >= 2
    assert min(more) >= 4
    assert int(before.window(0, 0, 1)["pseudo_labels"].max()) == counts[0]


def test_objects_of_clips_are_divided_too(clips: ArrayClips):
    source = ClipsWithPasted(clips, PastedClips(clips, **SETTINGS), seed=0)
    halved = source.divided_by(Halves())
    assert (source.divided, halved.divided) == (False, True)
    assert [int(each.window(0, 0, 1)["pseudo_labels"].max()) for each in (source, halved)] == [2, 4]


def test_forgotten_pseudo_objects_are_divided_again(clips: ArrayClips):
    halves = Halves()
    source = PastedClips(clips, **SETTINGS, kept_bytes=1).divided_by(halves)
    for _ in range(2):
        assert [source.window(index, 0, 1)["pseudo_labels"].max() >= 4 for index in range(2)] == [True, True]
    assert halves.asked > len(clips)


def test_from_the_start_on_the_model_divides_with_its_weights_of_that_time(clips: ArrayClips):
    model = eager()
    source = model.training_source(clips)
    assert model.next_source(source, START - 0.01) is source
    assert eager(override(CONFIG, {"model.self_training": False})).next_source(source, START) is source
    taught = model.next_source(source, START)
    assert model.next_source(taught, 1.0) is taught
    expected = deepcopy(model).next_source(source, START).window(0, 0, 1)["pseudo_labels"]
    for value in model.parameters():
        value.data.zero_()
    image = taught.window(0, 0, 1)["pseudo_labels"]
    assert torch.equal(image, expected)
    assert int(image.max()) > int(source.window(0, 0, 1)["pseudo_labels"].max())


def test_single_images_are_grouped_with_certainty(clips: ArrayClips, monkeypatch: pytest.MonkeyPatch):
    """Of two objects one is divided into halves, and of the other one five pixels are cut off, which are too few."""
    scene, asked = PastedClips(clips, **SETTINGS)._scene(0), []

    def groups(image: Image, bias: float) -> np.ndarray:
        asked.append(bias)
        rows, columns = np.nonzero(scene.labels == 1)
        found = scene.labels.astype(np.int64)
        found[rows[: len(rows) // 2], columns[: len(rows) // 2]] = 3
        found[tuple(np.argwhere(scene.labels == 2)[:5].T)] = 4
        return found[image.mask]

    monkeypatch.setattr(Image, "groups", groups)
    found = Teacher(eager())(scene)
    assert asked == [EVERYWHERE]
    assert [len(np.unique(found[scene.labels == name])) for name in (1, 2)] == [2, 1]


@pytest.mark.parametrize(("certainty", "parts"), [(0.8, 1), (0.84, 2)])
def test_objects_are_divided_where_the_network_is_at_least_82_percent_certain(
    clips: ArrayClips, monkeypatch: pytest.MonkeyPatch, certainty: float, parts: int
):
    """The bias is the logit of this certainty. The network sees a border across the middle of each object."""
    monkeypatch.setattr("obpose.contact.model.DIVISION_BIAS", DIVISION_BIAS)
    scene, model = PastedClips(clips, **SETTINGS)._scene(0), eager()
    halves = Halves()(scene)
    logits = affinities(halves, 9.0)
    logits[logits < 0] = np.log(1 / certainty - 1)
    objects = torch.from_numpy(np.where(scene.labels > 0, 1.0, -1.0))[None].float()
    outputs = Outputs(objects, torch.zeros(1, EMBEDDING, *objects.shape[1:]), torch.from_numpy(logits)[None])
    monkeypatch.setattr(model, "outputs", lambda images: outputs)
    found = Teacher(model)(scene)
    assert [len(np.unique(found[scene.labels == name])) for name in (1, 2)] == [parts, parts]


def test_clean_images_are_not_cleaned_again(clips: ArrayClips, monkeypatch: pytest.MonkeyPatch):
    scene = PastedClips(clips, **SETTINGS)._scene(0)
    monkeypatch.setattr("obpose.contact.model.clean_depth", lambda observation: pytest.fail("it was cleaned"))
    assert Teacher(eager(override(CONFIG, {"model.clean_depth": True})))(scene).max() >= scene.count


def test_random_numbers_are_left_alone(clips: ArrayClips):
    model = eager()
    before = torch.get_rng_state()
    model.next_source(model.training_source(clips), START)
    assert torch.equal(torch.get_rng_state(), before)


def test_validation_images_are_divided_like_those_of_the_training(clips: ArrayClips, monkeypatch: pytest.MonkeyPatch):
    seen: list[tuple[ClipSource, bool]] = []
    window = PastedClips.window
    monkeypatch.setattr(
        PastedClips, "window", lambda self, *rest: seen.append((self._source, self.divided)) or window(self, *rest)
    )
    val = ArrayClips([balls(PLACES * [-1, 1, 1])[0]])
    train(clips, val, override(CONFIG, {"train.steps": 4, "train.batch": 2}), device="cpu", build=eager)
    for source in (clips, val):
        assert {divided for used, divided in seen if used is source} == {False, True}


def test_obpose_divides_as_its_contact_model_does(clips: ArrayClips):
    config = find_system("obpose-contact").config("cpu", {"contact.self_training": True, "model.voxels": 4})
    model, other = build_contact_obpose(config), build_contact_obpose(config)
    source = model.training_source(clips)
    assert model.next_source(source, START - 0.01) is source
    taught = model.next_source(source, START)
    assert isinstance(taught, ClipsWithPasted)
    assert taught.divided
    other.restore_training_state(model.training_state())
    weights = model.contact.state_dict()
    assert all(torch.equal(value, weights[name]) for name, value in other.training_state().items())
    assert weights.keys() == other.training_state().keys()


@pytest.mark.parametrize("config", [SupervisedConfig(), OgcConfig()])
def test_models_without_pseudo_objects_refuse_it(config: ContactConfig):
    with pytest.raises(UsageError, match=r"model\.self_training is True; expected false"):
        check_contact_bounds(override(config, {"model.self_training": True}))


def test_true_labels_are_not_divided(clips: ArrayClips):
    config = override(SupervisedConfig(), {"model.self_training": True})
    assert Supervised(config).next_source(clips, 1.0) is clips


@pytest.mark.parametrize("step", [3, 4])
def test_a_run_that_was_stopped_goes_on_with_the_same_teacher(tmp_path: Path, clips: ArrayClips, step: int):
    config = override(CONFIG, {"train.steps": 6, "train.batch": 2, "train.learning_rate": 0.05})

    def run(folder: Path, report: Callable[[Status], None] = lambda status: None) -> dict[str, torch.Tensor]:
        return train(clips, None, config, folder=folder, device="cpu", report=report, build=eager).model.state_dict()

    def stop(status: Status) -> None:
        if status.step == step:
            signal.raise_signal(signal.SIGTERM)

    whole = run(tmp_path / "whole")
    with pytest.raises(Interrupted):
        run(tmp_path / "parts", stop)
    parts = run(tmp_path / "parts")
    assert all(torch.equal(value, parts[name]) for name, value in whole.items())


def test_teachers_of_other_models_are_refused():
    model = eager()
    model.next_source(model.training_source(ArrayClips([balls(PLACES)[0]])), 1.0)
    state = model.training_state()
    other = ContactModel(ContactConfig())
    other.restore_training_state({})
    assert other.training_state() == {}
    other.restore_training_state(state)
    assert all(torch.equal(value, state[name]) for name, value in other.training_state().items())
    lacking = {name: value for name, value in state.items() if name != "network.stem.bias"}
    wrong = {**state, "network.stem.bias": torch.zeros(1)}
    rounded = {name: value.to(torch.bfloat16) for name, value in state.items()}
    for broken in (lacking, wrong, rounded):
        with pytest.raises(UsageError, match="copy of the network that divides pseudo-objects does not fit"):
            ContactModel(ContactConfig()).restore_training_state(broken)


def eager(config: ContactConfig = CONFIG) -> ContactModel:
    """A model that takes everything for foreground."""
    torch.manual_seed(0)
    model = ContactModel(config)
    model.network.head[-1].bias.data[0] = 9.0
    return model
