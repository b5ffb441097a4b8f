import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.studies.__main__ import main
from benchmark.studies.views import (
    CARRIED,
    COPIED,
    FLAT,
    MEAN,
    MODEL,
    Picture,
    Similarity,
    View,
    carry_points,
    compare,
    flatten_masks,
    mean_pictures,
    measure_views,
    read_views,
    summarise_pictures,
)
from datagen.config import Rig
from datagen.geometry import unproject
from datagen.storage.reader import Dataset, Split
from obpose.scenes.model_ref import Origin
from tests.benchmark.studies.conftest import printed_table
from tests.worlds import moving_cameras, rendered

NOTHING = Picture(np.zeros((32, 32, 3)), np.zeros((32, 32)))


@pytest.fixture(scope="module")
def scenes(stills: Path) -> Split:
    return Dataset(stills).split("train")


def like(picture: Picture, truth: View, maker: str = MODEL) -> Similarity:
    return compare(picture, truth, scene=0, maker=maker, same_view=False)


@pytest.fixture(scope="module")
def views(scenes: Split) -> list[View]:
    return read_views(scenes, 0, 0)


def test_the_truth_is_like_itself_and_unlike_another_view(views: list[View]):
    same = like(views[1].picture, views[1])
    assert (same.psnr, same.ssim, same.same_view) == (math.inf, pytest.approx(1), False)
    assert not same.depth_errors.any()
    assert len(same.depth_errors_objects) == views[1].objects.sum() > 0
    other = like(views[0].picture, views[1])
    assert other.psnr < 40
    assert np.median(other.depth_errors_objects) > 0.003


def test_points_carried_into_their_own_view_stay_where_they_are(views: list[View]):
    back = carry_points(views[0], views[0], NOTHING)
    np.testing.assert_array_equal(back.rgb, views[0].picture.rgb * (views[0].picture.depth > 0)[..., None])
    assert back.depth == pytest.approx(views[0].picture.depth, abs=1e-9)


def test_points_carried_into_another_view_lie_on_its_surfaces(views: list[View]):
    there = carry_points(views[0], views[1], NOTHING)
    errors = np.abs(there.depth - views[1].picture.depth)[there.depth > 0]
    # What hides them from the other view is not known: some lie behind its surfaces.
    assert len(errors) > 300
    assert np.median(errors) < 0.01


def test_nearer_points_hide_farther_ones(views: list[View]):
    """Seen from far away all points fall into a few pixels."""
    away = views[0].world_from_camera.copy()
    away[:3, 3] -= 50 * away[:3, 2]
    far = replace(views[0], world_from_camera=away)
    there = carry_points(views[0], far, NOTHING)
    assert 0 < (there.depth > 0).sum() < 40
    assert there.depth[there.depth > 0].min() == pytest.approx(views[0].picture.depth.min() + 50, abs=0.05)


def test_the_mean_of_equal_scenes_is_the_scene(scenes: Split, views: list[View]):
    mean = mean_pictures(scenes, 5)
    assert len(mean) == 2
    assert mean[1].rgb == pytest.approx(views[1].picture.rgb)


def test_every_view_is_once_the_input(stills: Path, origin: Origin):
    found = list(measure_views(origin, stills, "train", scenes=1, frames=3))
    makers = [(one.maker, one.same_view) for one in found]
    assert makers.count((MODEL, True)) == makers.count((FLAT, True)) == makers.count((MODEL, False)) == 2
    assert makers.count((FLAT, False)) == 0
    assert all(makers.count((maker, False)) == 2 for maker in (CARRIED, COPIED, MEAN))
    assert all(math.isfinite(one.ssim) for one in found)


def test_moving_cameras_have_another_pose_in_each_frame(origin: Origin, tmp_path: Path):
    world = moving_cameras.orbiting(rendered.scene(frames=3, views=2))
    record = rendered.record(world, resolution=(32, 32))
    folder = rendered.write_dataset(tmp_path / "moving", [record, record], rig=Rig(motion="orbit"))
    table = read_views(Dataset(folder).split("train"), 0, 2)[1]
    heights = unproject(table.picture.depth, table.k, table.world_from_camera)[..., 2]
    assert np.max(np.abs(heights[~table.objects & (table.picture.depth > 0)])) < 1e-3
    found = list(measure_views(origin, folder, "train", scenes=1, frames=3))
    means = [one.depth_errors.max() for one in found if one.maker == MEAN]
    assert len(means) == 6
    assert max(means) == 0, "equal scenes have the same mean in every frame"


def test_flat_masks_keep_means_and_lose_all_else(views: list[View]):
    plain = flatten_masks(views[0])
    truth = views[0].picture
    masks = [views[0].labels == label for label in np.unique(views[0].labels)]
    assert len(masks) > 2
    for mask in masks:
        assert plain.rgb[mask].mean(axis=0) == pytest.approx(truth.rgb[mask].mean(axis=0))
        assert plain.depth[mask].mean() == pytest.approx(truth.depth[mask].mean())
        assert np.ptp(plain.rgb[mask], axis=0).max() == np.ptp(plain.depth[mask]) == 0
    assert np.ptp(truth.depth[masks[1]]) > 0


def test_intervals_are_over_scenes_and_not_over_their_pictures(views: list[View]):
    one = like(views[0].picture, views[1])
    rng = np.random.default_rng(0)
    hardness = rng.normal(25, 3, 40)
    alike = [replace(one, scene=scene, psnr=float(hardness[scene])) for scene in range(40) for _ in range(9)]
    (line,) = summarise_pictures(alike, 0)
    mean, low, high = (float(line[name]) for name in ("psnr", "psnr_ci_low", "psnr_ci_high"))
    assert mean == pytest.approx(hardness.mean())
    assert low < mean < high
    assert high - low == pytest.approx(2 * 1.96 * hardness.std() / 40**0.5, rel=0.1)


def test_a_scene_without_objects_counts_for_the_image_alone(views: list[View]):
    one = like(views[0].picture, views[1])
    found = [replace(one, scene=scene, psnr=20.0 + scene, psnr_objects=float("nan")) for scene in range(2)]
    found += [replace(one, scene=2, psnr=22.0, psnr_objects=15.0)]
    (line,) = summarise_pictures(found, 0)
    assert line["psnr"] == pytest.approx(21)
    assert line["psnr_objects"] == line["psnr_objects_ci_low"] == line["psnr_objects_ci_high"] == 15


def test_what_was_refined_is_said_of_the_model_alone(views: list[View]):
    both = [like(views[0].picture, views[1], maker) for maker in (MODEL, COPIED)]
    assert {line["by"]: line["refinements"] for line in summarise_pictures(both, 100)} == {MODEL: 100, COPIED: 0}


def test_the_command_prints_a_table_and_writes_it(
    clips: Path, checkpoint: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    flags = ["--data", str(clips), "--checkpoint", str(checkpoint), "--scenes", "1", "--frames", "2"]
    assert main(["views", *flags, "--csv", str(tmp_path / "views.csv")]) == 0
    printed = printed_table(capsys.readouterr().out)
    written = list(csv.DictReader((tmp_path / "views.csv").read_text().splitlines()))
    assert [line["by"] for line in written] == [MODEL, FLAT]
    for line, shown in zip(written, printed, strict=True):
        assert (line["data"], line["split"], line["picture"]) == (clips.name, "test", "the input view")
        assert (line["pictures"], line["refinements"]) == ("2", "0")
        assert float(line["psnr_ci_low"]) <= float(line["psnr"]) <= float(line["psnr_ci_high"])
        assert float(shown["psnr"]) == pytest.approx(float(line["psnr"]), rel=1e-3)


def test_fitted_scenes_are_other_ones(clips: Path, origin: Origin):
    plain, fitted = (list(measure_views(origin, clips, "test", scenes=1, frames=1, refinements=n)) for n in (0, 3))
    changed = {before.maker: before.psnr != after.psnr for before, after in zip(plain, fitted, strict=True)}
    assert changed == {MODEL: True, FLAT: False}
