import csv
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image as Pillow

from benchmark.models.interface import Prediction
from benchmark.studies.creation.sampled import ari_fg, labelled, looks, mean_ari_fg, real_scenes, sampled_scenes
from benchmark.studies.creation.samples_cli import COLUMNS, GAP, main, shipped_to_segment
from datagen.storage.reader import Dataset
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors import load_prior
from obpose.scenes.priors.flow import Flow
from obpose.scenes.priors.flow_prior import save_flow
from obpose.scenes.priors.gaussian import save_gaussian
from obpose.scenes.priors.learned import learned_prior
from obpose.scenes.rendering import Image
from obpose.storage.pretrained import shipped_to_create
from tests.obpose.scenes.small_scenes import CAMERA


def image() -> Image:
    """Two objects before a wall a metre away; in the first row there is nothing."""
    shares = torch.zeros(3, 12, 16)
    shares[0, 1:] = 1.0
    for component, columns in ((1, slice(4)), (2, slice(8, 16))):
        shares[:, 3:9, columns] = 0.0
        shares[component, 3:9, columns] = 0.9
    rgb = torch.einsum("chw,cj->hwj", shares, torch.tensor([[0.5, 0.5, 0.5], [1.0, 0, 0], [0, 0, 1.0]]))
    return Image(rgb, torch.full((12, 16), 1.0), shares)


def test_a_rendered_image_is_labelled_by_what_is_seen():
    scene = labelled(image(), CAMERA)
    assert set(np.unique(scene.labels)) == {0, 1, 2}
    assert not scene.clip.valid[0, 0, 0].any()
    assert scene.clip.valid[0, 0, 1:].all()
    assert not scene.labels[0, 0, 0].any()
    assert not scene.clip.depth[0, 0, 0].any()
    assert scene.clip.rgb[0, 0, 5, 0].tolist() == [round(0.9 * 255), 0, 0]


def test_looks_are_metres_and_colours():
    found = looks([labelled(image(), CAMERA)] * 2)
    assert found.scene.tolist() == [0, 0, 1, 1]
    # The camera looks down with 24 pixels a metre; points are those of pixels' middles.
    assert found.size[0] == pytest.approx([5 / 24, 3 / 24, 0], abs=1e-6)
    assert found.size[1] == pytest.approx([7 / 24, 5 / 24, 0], abs=1e-6)
    assert found.colour[1] == pytest.approx([0, 0, 0.9], abs=0.01)


def test_agreement_is_of_the_labels():
    scene = labelled(image(), CAMERA)
    assert ari_fg(Prediction(scene.labels, 0), scene) == 1
    assert ari_fg(Prediction(np.minimum(scene.labels, 1), 0), scene) == 0

    class Right:
        def fit(self, train, val, *, seed, budget): ...

        def segment(self, clip):
            return Prediction(scene.labels, 0)

    assert mean_ari_fg(Right(), [scene, scene]) == 1


def test_real_scenes_are_the_first_image_of_each(clips: Path):
    scenes = Dataset(clips).split("test")
    real = real_scenes(scenes, 9)
    assert len(real) == 2
    np.testing.assert_array_equal(real[1].labels[0, 0], scenes[1]["segmentation"][0, 0])


def test_sampled_scenes_have_the_cameras_of_real_ones_and_depend_on_the_seed(clips: Path, origin: Origin):
    real = real_scenes(Dataset(clips).split("test"), 2)
    one, same, other = (
        list(sampled_scenes(origin, load_prior(origin, "learned"), real, seed=seed)) for seed in (0, 0, 1)
    )
    for scene, like in zip(one, real, strict=True):
        assert scene.clip.rgb.shape == like.clip.rgb.shape
        np.testing.assert_allclose(scene.clip.world_from_camera, like.clip.world_from_camera, atol=1e-6)
    np.testing.assert_array_equal(one[1].clip.rgb, same[1].clip.rgb)
    assert not np.array_equal(one[0].clip.rgb, other[0].clip.rgb)


def test_the_command_prints_and_draws(
    clips: Path, checkpoint: Path, origin: Origin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    save_gaussian(origin, learned_prior(origin))
    flags = ["--data", str(clips), "--checkpoint", str(checkpoint), "--scenes", "2"]
    assert main([*flags, "--picture", str(tmp_path / "grid.png"), "--csv", str(tmp_path / "samples.csv")]) == 0
    printed = capsys.readouterr().out
    assert all(f"| {name} |" in printed for name in ("real (test)", "real (val)", "sampled, prior gaussian"))
    kept = list(csv.DictReader((tmp_path / "samples.csv").read_text().splitlines()))
    assert {line["segmenter"] for line in kept} == {str(checkpoint)}
    assert f"segments with {checkpoint}, the weights that sample" in printed
    assert [line["mmd2 size p"] != "" for line in kept[:2]] == [False, True]
    assert f"| {float(kept[1]['mmd2 size']):z.4f} ({float(kept[1]['mmd2 size p']):.3f}) |" in printed
    width = 2 * (96 + 2 * GAP)
    with Pillow.open(tmp_path / "grid.png") as picture:
        assert picture.size == (width, 3 * (96 + 2 * GAP))
    assert COLUMNS >= 2
    assert main([*flags, "--split", "val"]) == 2
    save_flow(origin, Flow(origin.model.config.model.latent.what))
    assert main(flags) == 0
    assert "| sampled, prior flow |" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("track", "name"), [("moving", "obpose--moving--64x64"), ("clevr3d", "obpose--clevr3d--80x60")]
)
def test_other_weights_segment_what_the_ones_for_pictures_sample(track: str, name: str):
    assert shipped_to_segment(track) == name != shipped_to_create(track)
    assert shipped_to_segment("nowhere") is None


def test_the_segmenter_is_the_one_that_is_named(
    clips: Path, checkpoint: Path, origin: Origin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    save_gaussian(origin, learned_prior(origin))
    flags = ["--data", str(clips), "--checkpoint", str(checkpoint), "--scenes", "2", "--segmenter"]
    assert main([*flags, "obpose--moving--64x64", "--csv", str(tmp_path / "samples.csv")]) == 0
    assert "segments with obpose--moving--64x64.\n" in capsys.readouterr().out
    kept = list(csv.DictReader((tmp_path / "samples.csv").read_text().splitlines()))
    assert {(line["model"], line["segmenter"]) for line in kept} == {(str(checkpoint), "obpose--moving--64x64")}
    assert main([*flags, "nowhere"]) == 2
