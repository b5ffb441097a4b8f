import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from obpose.errors import UsageError
from obpose.model.nerf.along import JITTER
from obpose.model.nerf.field import Conditioning, Hidden
from obpose.model.obpose import ObPose
from obpose.scenes import edit
from obpose.scenes.meshes import SURFACE, SURFACE_OF_FIELD, object_mesh, to_glb, write_mesh
from obpose.scenes.scene import Scene
from tests.obpose.analytic_fields import BallField
from tests.obpose.scenes.small_scenes import some_model, some_scene


def ball_scene(radius: float) -> tuple[ObPose, Scene]:
    """Objects that are balls; the radius in half edges of their boxes of 20 cm."""
    model = some_model()
    model.object_field = BallField(radius, latent=32)
    return model, some_scene()


def test_a_ball_is_a_closed_ball_of_its_colour():
    model, scene = ball_scene(0.5)
    mesh = object_mesh(model, scene, 2, frame=1)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=0.03)
    away = np.linalg.norm(mesh.vertices - scene.center[1, 1].numpy(), axis=1)
    np.testing.assert_allclose(away, 0.05, atol=2.2e-3)  # half a cell: the field is a step
    assert np.unique(mesh.visual.vertex_colors, axis=0).tolist() == [[255, 128, 64, 255]]


def test_what_reaches_beyond_the_box_is_closed_by_its_faces():
    model, scene = ball_scene(1.2)
    mesh = object_mesh(model, scene, 1)
    assert mesh.is_watertight
    in_box = (mesh.vertices - scene.center[0, 0].numpy()) @ scene.rotation[0, 0].numpy()
    assert np.abs(in_box).max() == pytest.approx(0.1, abs=1e-6)


def test_it_moves_with_the_object():
    model, scene = ball_scene(0.5)
    by = torch.tensor([0.1, 0.0, 0.2])
    before, after = object_mesh(model, scene, 1), object_mesh(model, edit.move(scene, 1, by), 1)
    np.testing.assert_allclose(after.vertices - before.vertices, by.expand(len(before.vertices), 3), atol=1e-5)


@pytest.mark.parametrize("height", [0.0, 0.02])
def test_a_mesh_is_cut_at_the_floor(height: float):
    model, scene = ball_scene(0.5)
    scene = replace(scene, center=torch.zeros_like(scene.center) + torch.tensor([0.0, 0.0, height]))
    mesh = object_mesh(model, scene, 1, floor=0.0)
    assert mesh.is_watertight
    assert mesh.bounds[:, 2] == pytest.approx([0.0, 0.05 + height], abs=1e-3)
    cap = np.pi * (0.05 - height) ** 2 * (3 * 0.05 - (0.05 - height)) / 3
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.05**3 - cap, rel=0.05)
    with pytest.raises(UsageError, match="is dense at none of"):
        object_mesh(model, scene, 1, floor=0.2)


class Fuzzy(BallField):
    """A ball whose density rises by one logit per 0.1 box units."""

    def density(self, points: torch.Tensor, codes: Conditioning) -> tuple[torch.Tensor, Hidden]:
        logits, hidden = super().density(points, codes)
        return 10 * (self.radius - points.norm(dim=-1)), Hidden(logits.new_zeros(*logits.shape, 16), hidden.correction)


@pytest.mark.parametrize("density", [0.5, 0.9])
def test_the_surface_is_where_the_density_is_as_large_as_given(density: float):
    model, scene = ball_scene(0.5)
    model.object_field = Fuzzy(0.5, latent=32)
    mesh = object_mesh(model, scene, 1, surface=density)
    away = torch.from_numpy(mesh.vertices - scene.center[0, 0].numpy()).norm(dim=1) * 2 / 0.2
    found = torch.tanh(torch.nn.functional.softplus(10 * (0.5 - away)))
    torch.testing.assert_close(found, torch.full_like(found, density), atol=0.01, rtol=0)


def test_the_surface_is_denser_if_frames_showed_no_extents():
    """Fields are larger than objects, and only a known extent makes up for it."""
    model, scene = ball_scene(0.5)
    model.object_field = Fuzzy(0.5, latent=32)
    for extent, density in ((0.0, SURFACE_OF_FIELD), (1.0, SURFACE)):
        half_extent = torch.full_like(scene.appearance.half_extent, extent)
        found = object_mesh(model, scene.with_appearance(half_extent=half_extent), 1)
        assert found.volume == pytest.approx(object_mesh(model, scene, 1, surface=density).volume, rel=1e-6)


def cubes() -> tuple[ObPose, Scene]:
    """Objects that fill their boxes, grey; the upper half of the second is taken away, and the rest is red."""
    model, scene = some_model(), some_scene()
    with torch.no_grad():
        for layer, bias in ((model.object_field.density_logit, 20.0), (model.object_field.colour_out, 0.0)):
            layer.weight.zero_()
            layer.bias.fill_(bias)
    detail = torch.zeros_like(scene.appearance.detail)
    detail[1, :, :, 8:, 0] = -100.0
    detail[1, ..., 1:] = torch.tensor([20.0, -20.0, -20.0])
    return model, scene.with_appearance(detail=detail)


def test_meshes_have_the_details_of_their_object():
    model, scene = cubes()
    whole, half = object_mesh(model, scene, 1), object_mesh(model, scene, 2)
    assert whole.volume == pytest.approx(0.2**3, rel=0.05)
    assert half.volume == pytest.approx(0.2**3 / 2, rel=0.1)
    assert np.abs(np.asarray(whole.visual.vertex_colors)[:, :3].astype(int) - 128).max() <= 1
    assert np.unique(half.visual.vertex_colors, axis=0).tolist() == [[255, 0, 0, 255]]


@pytest.mark.parametrize("name", ["ball.ply", "ball.glb"])
def test_files_are_read_again(tmp_path: Path, name: str):
    model, scene = ball_scene(0.5)
    mesh = object_mesh(model, scene, 1, resolution=16)
    write_mesh(tmp_path / name, mesh)
    found = trimesh.load(tmp_path / name, force="mesh")
    assert len(found.faces) == len(mesh.faces)  # pyright: ignore[reportAttributeAccessIssue]
    assert found.bounds == pytest.approx(mesh.bounds, abs=1e-5)


def test_nothing_and_other_endings_are_told(tmp_path: Path):
    with pytest.raises(UsageError, match=r"Object 1 is dense at none of .* unless more of them"):
        object_mesh(*ball_scene(-10.0), 1)
    with pytest.raises(UsageError, match=r"ends with \.ply or \.glb"):
        write_mesh(tmp_path / "ball.obj", object_mesh(*ball_scene(0.5), 1, resolution=8))


class Shells(BallField):
    """A ball whose colour says how far from the middle it is, in box coordinates."""

    def density(self, points: torch.Tensor, codes: Conditioning) -> tuple[torch.Tensor, Hidden]:
        logits, _ = super().density(points, codes)
        return logits, Hidden(points.norm(dim=-1, keepdim=True), None)

    def colour(self, hidden: Hidden, directions: torch.Tensor, codes: Conditioning) -> torch.Tensor:
        return hidden.values.expand(*hidden.values.shape[:-1], 3)


def test_colours_are_those_of_as_far_behind_the_surface_as_they_were_trained():
    model, scene = ball_scene(0.5)
    model.object_field = Shells(0.5, latent=32)
    mesh = object_mesh(model, scene, 2, frame=1)
    behind = 2 * JITTER / model.config.model.pose.box_size
    assert behind > 0.05
    found = mesh.visual.vertex_colors[:, 0] / 255
    np.testing.assert_allclose(found, 0.5 - behind, atol=0.03)


def test_vertex_colours_of_glb_files_are_linear():
    """188 is the sRGB value of half the light."""
    mesh = trimesh.creation.box()
    mesh.visual.vertex_colors = [0, 188, 255, 128]
    read = trimesh.load(io.BytesIO(to_glb(mesh)), file_type="glb", force="mesh")
    assert read.visual.vertex_colors[0].tolist() == [0, 128, 255, 128]


def test_a_mesh_shrinks_to_what_the_frames_showed_of_its_object():
    model, scene = ball_scene(0.5)
    seen = torch.zeros_like(scene.appearance.half_extent)
    seen[0] = torch.tensor([0.02, 0.03, 0.2])
    scene = scene.with_appearance(half_extent=seen)
    mesh, unknown = object_mesh(model, scene, 1), object_mesh(model, scene, 2)
    in_box = (mesh.vertices - scene.center[0, 0].numpy()) @ scene.rotation[0, 0].numpy()
    assert np.abs(in_box).max(axis=0) == pytest.approx([0.02, 0.03, 0.05], abs=2e-3)
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.02 * 0.03 * 0.05, rel=0.05)
    assert unknown.volume == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=0.03)
