import io

import numpy as np
import torch
from PIL import Image as Pillow

from obpose.pictures import PALETTE
from obpose.scenes.pictures import strip, strips, turntable, write_gif, write_png
from obpose.scenes.rendering import Image
from tests.obpose.scenes.small_scenes import CAMERA


def image() -> Image:
    """Half background, half the second of two objects, which is nearer."""
    shares = torch.zeros(3, 8, 8)
    shares[0, :, :4], shares[2, :, 4:] = 1, 1
    depth = torch.where(shares[2] > 0, 0.5, 1.0)
    return Image(rgb=torch.rand(8, 8, 3), depth=depth, shares=shares)


def test_a_strip_shows_colour_depth_and_the_objects_names():
    shown = image()
    picture = strip(shown, [1, 7])
    assert picture.shape == (256, 3 * 256, 3)
    np.testing.assert_array_equal(picture[16, 16], (shown.rgb[0, 0] * 255).round().numpy())
    assert (picture[:, 256 : 256 + 128] == 0).all()
    assert (picture[:, 256 + 128 : 512] == 255).all()
    np.testing.assert_array_equal(picture[0, 512], PALETTE[0])
    np.testing.assert_array_equal(picture[0, -1], PALETTE[7])


def test_the_number_of_an_object_stands_at_its_centre():
    picture = strip(image(), [1, 7])[:, 512:]
    written = np.argwhere((picture != PALETTE[7]).any(axis=-1)[:, 128:])
    assert len(written) > 20
    np.testing.assert_allclose(written.mean(axis=0), [128, 64], atol=16)
    np.testing.assert_array_equal(strip(image(), [1, 7])[:, 512:640], np.zeros((256, 128, 3)))


def test_equal_depths_have_equal_brightness_in_all_strips_of_an_animation():
    first, nearer = image(), image()
    nearer.depth[0, 0] = 0.25
    depths = [picture[8:, 256:512] for picture in strips([first, nearer], [1, 2])]
    assert (depths[0][64:] == depths[1][64:]).all()
    assert (strip(nearer, [1, 2])[64:, 384:512] < 255).all()


def test_files_hold_what_was_drawn(tmp_path):
    pictures = [strip(image(), [1, 2]), strip(image(), [2, 1])]
    write_png(tmp_path / "a.png", pictures[0])
    with Pillow.open(tmp_path / "a.png") as found:
        np.testing.assert_array_equal(np.array(found), pictures[0])
    write_gif(tmp_path / "a.gif", pictures, fps=4.0)
    with Pillow.open(io.BytesIO((tmp_path / "a.gif").read_bytes())) as found:
        assert found.n_frames == 2  # pyright: ignore[reportAttributeAccessIssue]
        assert found.info["duration"] == 250


def test_a_gif_keeps_the_colours_of_small_regions(tmp_path):
    noise = np.random.default_rng(0).integers(50, 120, (128, 128, 3), dtype=np.uint8)
    noise[30:32, 30:32] = [130, 110, 20]
    ramp = np.arange(0, 256, 2, dtype=np.uint8)[:, None, None].repeat(128, 1).repeat(3, 2)
    write_gif(tmp_path / "a.gif", [np.concatenate([noise, ramp], axis=1)], fps=4.0)
    with Pillow.open(tmp_path / "a.gif") as found:
        kept = np.array(found.convert("RGB"))[31, 31]
    np.testing.assert_allclose(kept.astype(int), [130, 110, 20], atol=10)


def test_a_turntable_goes_round_and_looks_at_the_same_point():
    center = torch.tensor([0.0, 0.0, 0.0])
    pose = CAMERA.world_from_camera.clone()
    pose[:3, 3] = torch.tensor([0.0, -0.5, 1.0])
    cameras = turntable(type(CAMERA)(CAMERA.k, pose, 16, 12), center, 4)
    places = torch.stack([camera.world_from_camera[:3, 3] for camera in cameras])
    expected = torch.tensor([[0.0, -0.5, 1.0], [0.5, 0.0, 1.0], [0.0, 0.5, 1.0], [-0.5, 0.0, 1.0]])
    torch.testing.assert_close(places, expected, atol=1e-6, rtol=0)
    seen = [camera.world_from_camera[:3, :3].T @ (center - camera.world_from_camera[:3, 3]) for camera in cameras]
    for other in seen[1:]:
        torch.testing.assert_close(other, seen[0], atol=1e-6, rtol=0)
