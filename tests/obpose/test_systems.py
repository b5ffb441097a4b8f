import pytest
import torch

from datagen.config import load_recipe
from datagen.tracks import all_tracks
from obpose.baselines.obsurf.config import ObsurfConfig
from obpose.baselines.obsurf.model import Obsurf
from obpose.baselines.supervised import Supervised
from obpose.config import Config
from obpose.config_text import from_plain, to_plain
from obpose.contact.config import ContactConfig, ContactObPoseConfig, OgcConfig, SupervisedConfig
from obpose.data.scene_stats import SceneMeasures
from obpose.errors import UsageError
from obpose.model.obpose import ObPose
from obpose.systems import ARCHITECTURES, SYSTEMS, architecture_of, build_model, find_system, slots_for, system_of
from obpose.types import LabelledObservation
from obpose.variants import VARIANTS, make_config

MEASURES = SceneMeasures(0.02, (0.1, 0.2, 0.3), 0.7, 1.9, 0.001, 1).changes()


@pytest.mark.parametrize(("name", "profile"), [(n, p) for n, s in SYSTEMS.items() for p in s.architecture.profiles])
def test_every_system_can_be_trained_in_every_profile_and_survives_as_text(name: str, profile: str):
    system = SYSTEMS[name]
    config = system.config(profile, {"train.steps": 1})
    system.architecture.check(config)
    assert architecture_of(config) is system.architecture
    assert from_plain(to_plain(config), system.architecture.config) == config


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_variant_of_obpose_is_what_it_was(variant: str):
    assert SYSTEMS[variant].config("gpu", {"train.seed": 3}) == make_config(variant, "gpu", **{"train.seed": 3})


@pytest.mark.parametrize("name", ["obsurf", "obsurf-no-overlap", "obsurf-no-overlap-depth"])
def test_what_was_searched_for_minutes_on_a_core_is_not_what_the_authors_trained_with(name: str):
    paper = SYSTEMS[name].config("paper").train
    assert (paper.learning_rate, paper.object_rays, paper.rays, paper.batch) == (4e-4, 0.0, 4096, 64)
    assert SYSTEMS[name].config("gpu").train.object_rays == 0.0


def test_every_name_says_what_it_is():
    assert all(system.description for system in SYSTEMS.values())
    assert len({system.description for system in SYSTEMS.values()}) == len(SYSTEMS)


def test_the_measures_of_a_scene_reach_whoever_has_a_value_for_them():
    obsurf, masks, contact = (SYSTEMS[name] for name in ("obsurf", "contact-masks", "obpose-contact"))
    known = {*masks.known(MEASURES), *contact.known(MEASURES)}
    assert {name.split(".")[1] for name in known} == {name.split(".")[1] for name in MEASURES}
    assert "contact.noise" in contact.known(MEASURES)
    config = obsurf.config("cpu", obsurf.known(MEASURES))
    assert config.model.workspace_center == (0.1, 0.2, 0.3)
    assert set(obsurf.known(MEASURES)) == {"model.workspace_center"}


@pytest.mark.parametrize(("name", "profile"), [(n, p) for n, s in SYSTEMS.items() for p in s.architecture.profiles])
def test_a_run_of_a_system_is_known_as_one(name: str, profile: str):
    system = SYSTEMS[name]
    run = {**system.known(slots_for(10)), "train.seed": 3, "train.steps": 7, "train.learning_rate": 0.5}
    assert system_of(system.config(profile, {**run, **system.known(MEASURES)})) == name


def test_a_configuration_says_which_model_it_is_of():
    torch.manual_seed(0)
    assert isinstance(build_model(Config()), ObPose)
    assert isinstance(build_model(ObsurfConfig()), Obsurf)
    assert isinstance(build_model(SupervisedConfig()), Supervised)
    assert {type(architecture.config()) for architecture in ARCHITECTURES.values()} == {
        Config,
        ObsurfConfig,
        SupervisedConfig,
        ContactConfig,
        OgcConfig,
        ContactObPoseConfig,
    }
    with pytest.raises(TypeError, match="configured by SceneMeasures"):
        architecture_of(SceneMeasures(0.02, (0.0, 0.0, 0.0), 1.0, 1.0, 0.0, 1))


def test_a_system_that_uses_labels_is_one_whose_model_sees_them():
    torch.manual_seed(0)
    for name in ("obpose", "obsurf", "supervised", "contact-masks", "ogc", "obpose-contact"):
        system = SYSTEMS[name]
        assert (build_model(system.config()).observation_type is LabelledObservation) is system.uses_labels


def test_a_misspelt_name_gets_a_hint():
    with pytest.raises(UsageError, match=r"Unknown variant 'obsrf'; did you mean 'obsurf'\? There are: obpose, "):
        find_system("obsrf")


def test_what_a_system_is_told_follows_from_its_values():
    assert SYSTEMS["obpose"].priors == ("slots", "background slot", "camera pose", "plane", "object size")
    assert SYSTEMS["ic-sbp"].priors == SYSTEMS["obsurf"].priors == ("slots", "camera pose")


@pytest.mark.parametrize(
    ("track", "bias", "translation"),
    [
        ("clevr3d", 2.5, 0.05),
        ("static", 2.5, 0.0),
        ("moving", 1.5, 0.0),
        ("mixed", 1.0, 0.0),
        ("touching", 0.0, 0.0),
        ("noisy", 1.0, 0.0),
    ],
)
def test_bias_and_translation_depend_on_the_track(track: str, bias: float, translation: float):
    system = find_system("obpose-contact")
    config = system.config("cpu", system.changes_on(track))
    assert (config.contact.bias, config.model.pose.max_translation) == (bias, translation)


@pytest.mark.parametrize("track", ["static", "moving", "mixed", "touching", "noisy"])
def test_systems_of_the_same_network_have_the_same_bias_on_a_track(track: str):
    with_poses, alone = (find_system(name) for name in ("obpose-contact", "contact-masks"))
    bias = with_poses.config("cpu", with_poses.changes_on(track)).contact.bias
    assert alone.config("cpu", alone.changes_on(track)).model.bias == bias


@pytest.mark.parametrize("track", [track.name for track in all_tracks() if track.name != "mixed"])
@pytest.mark.parametrize("name", ["obpose", "obpose-loc", "obpose-contact"])
def test_boxes_are_longer_than_the_objects_of_a_track(name: str, track: str):
    system = find_system(name)
    box = system.config("cpu", system.on_tracks.get(track, {})).model.pose.box_size
    assert box > load_recipe(track).objects.size[1] * 1.1
