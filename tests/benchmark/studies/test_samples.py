import csv
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image as Pillow

from benchmark.models.interface import Prediction
from benchmark.studies.__main__ import main
from benchmark.studies.samples import (
    GAP,
    ari_fg,
    label_image,
    mean_ari_fg,
    measure_looks,
    real_images,
    sampled_images,
    shipped_to_segment,
)
from datagen.errors import EXIT_USAGE
from datagen.storage.reader import Dataset
from obpose.model.layers.latent import LATENT
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors import load_prior
from obpose.scenes.priors.flow import Flow
from obpose.scenes.priors.flow_prior import save_flow
from obpose.scenes.priors.gaussian import learned_prior, save_gaussian
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
    scene = label_image(image(), CAMERA)
    assert set(np.unique(scene.labels)) == {0, 1, 2}
    assert not scene.clip.valid[0, 0, 0].any()
    assert scene.clip.valid[0, 0, 1:].all()
    assert not scene.labels[0, 0, 0].any()
    assert not scene.clip.depth[0, 0, 0].any()
    assert scene.clip.rgb[0, 0, 5, 0].tolist() == [round(0.9 * 255), 0, 0]


def test_looks_are_metres_and_colours():
    found = measure_looks([label_image(image(), CAMERA)] * 2)
    assert found.scene.tolist() == [0, 0, 1, 1]
    # The camera looks down with 24 pixels a metre; points are those of pixels' middles.
    assert found.size[0] == pytest.approx([5 / 24, 3 / 24, 0], abs=1e-6)
    assert found.size[1] == pytest.approx([7 / 24, 5 / 24, 0], abs=1e-6)
    assert found.colour[1] == pytest.approx([0, 0, 0.9], abs=0.01)


def test_agreement_is_of_the_labels():
    scene = label_image(image(), CAMERA)
    assert ari_fg(Prediction(scene.labels, 0), scene) == 1
    assert ari_fg(Prediction(np.minimum(scene.labels, 1), 0), scene) == 0

    class Right:
        def fit(self, train, val, *, seed, budget): ...

        def segment(self, clip):
            return Prediction(scene.labels, 0)

    assert mean_ari_fg(Right(), [scene, scene]) == 1


def test_real_scenes_are_the_first_image_of_each(clips: Path):
    scenes = Dataset(clips).split("test")
    real = real_images(scenes, 9)
    assert len(real) == 2
    np.testing.assert_array_equal(real[1].labels[0, 0], scenes[1]["segmentation"][0, 0])


def test_sampled_scenes_have_the_cameras_of_real_ones_and_depend_on_the_seed(clips: Path, origin: Origin):
    real = real_images(Dataset(clips).split("test"), 2)
    one, same, other = (
        list(sampled_images(origin, load_prior(origin, "learned"), real, seed=seed)) for seed in (0, 0, 1)
    )
    for scene, like in zip(one, real, strict=True):
        assert scene.clip.rgb.shape == like.clip.rgb.shape
        np.testing.assert_allclose(scene.clip.world_from_camera, like.clip.world_from_camera, atol=1e-6)
    np.testing.assert_array_equal(one[1].clip.rgb, same[1].clip.rgb)
    assert not np.array_equal(one[0].clip.rgb, other[0].clip.rgb)


@pytest.mark.slow
def test_the_command_compares_priors_and_draws(
    clips: Path, checkpoint: Path, origin: Origin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    save_gaussian(origin, learned_prior(origin))
    save_flow(origin, Flow(LATENT))
    files = {"--picture": tmp_path / "grid.png", "--csv": tmp_path / "samples.csv"}
    flags = ["--data", str(clips), "--checkpoint", str(checkpoint), "--scenes", "2"]
    assert main(["samples", *flags, *(str(word) for pair in files.items() for word in pair)]) == 0
    assert f"segments with {checkpoint}, which also samples" in capsys.readouterr().out
    kept = list(csv.DictReader(files["--csv"].read_text().splitlines()))
    sampled = [f"sampled, prior {name}" for name in ("flow", "gaussian", "learned")]
    assert [line["scenes"] for line in kept] == ["real (test)", "real (val)", *sampled]
    assert {line["segmenter"] for line in kept} == {str(checkpoint)}
    assert [line["mmd2 size p"] != "" for line in kept[:2]] == [False, True]
    with Pillow.open(files["--picture"]) as picture:
        assert picture.size == (2 * (96 + 2 * GAP), 4 * (96 + 2 * GAP))
    assert main(["samples", *flags, "--segmenter", "nowhere"]) == EXIT_USAGE
    assert "nowhere: no such folder" in capsys.readouterr().err


def test_other_weights_segment_than_those_that_sample():
    for track in ("moving", "clevr3d", "static", "multishape"):
        assert shipped_to_segment(track) not in (None, shipped_to_create(track))
    assert shipped_to_segment("nowhere") is None
