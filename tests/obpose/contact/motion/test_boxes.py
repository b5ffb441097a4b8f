import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from obpose.contact.motion.boxes import (
    FARTHEST,
    LEAST_POINTS,
    Surface,
    aligned,
    border_points,
    boxes_over_time,
    fused_points,
    linked_frames,
)
from obpose.contact.motion.rigidity import REST, Motion
from obpose.contact.motion.tracking import Cloud

HEIGHTS = 0.05, 0.03, 0.05, 0.03
"""Heights of four blocks of 2 cm, side by side along x."""


def surface(spacing: float = 0.004) -> tuple[np.ndarray, np.ndarray]:
    """Points of the blocks' tops, fronts and sides, around the middle of their box, and their normals."""
    across, blocks = np.arange(-0.03, 0.0301, spacing), []
    for number, height in enumerate(HEIGHTS):
        x, z = np.arange(0.0, 0.0201, spacing) + 0.02 * number, np.arange(0.0, height, spacing)
        for values, normal in (((x, across, [height]), 2), ((x, [-0.03], z), 1), ((x[:1], across, z), 0)):
            points = np.stack(np.meshgrid(*values, indexing="ij"), axis=-1).reshape(-1, 3)
            blocks.append((points - [0.04, 0, 0.025], np.tile(np.eye(3)[normal], (len(points), 1))))
    points, normals = (np.concatenate(values) for values in zip(*blocks, strict=True))
    return points, normals


def turned(degrees: float, shift: tuple[float, float, float] = (0, 0, 0), axis: str = "z") -> Motion:
    return Motion(Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), np.array(shift, float))


def black(points: np.ndarray) -> Cloud:
    return Cloud(points, np.zeros_like(points))


def seen(motion: Motion) -> Cloud:
    return motion.moved(black(surface()[0]))


def plate() -> np.ndarray:
    """Points of a horizontal square of 9 cm."""
    return np.stack([*np.mgrid[:0.095:0.01, :0.095:0.01], np.zeros((10, 10))], axis=-1).reshape(-1, 3)


def aligned_to_plate(points: np.ndarray) -> tuple[Motion, float]:
    return aligned(black(points), Surface(black(plate()), np.tile(np.eye(3)[2], (100, 1))), REST)


@pytest.mark.parametrize("motion", [turned(6, (0.005, -0.003, 0.0)), turned(10, (0.01, -0.003, 0.002))])
def test_registration_finds_the_motion_between_visible_sides(motion: Motion):
    points, normals = surface()
    found, residual = aligned(seen(motion), Surface(black(points), normals), REST)
    assert residual < 2e-4
    np.testing.assert_allclose(found.inverse.rotation, motion.rotation, atol=0.01)
    np.testing.assert_allclose(found.inverse.shift, motion.shift, atol=0.001)


def test_misplaced_points_hardly_move_the_others():
    """Every seventh point is 9 mm too high, which is 1.4 mm on average."""
    points = plate()
    points[::7, 2] += 0.009
    motion, _ = aligned_to_plate(points)
    np.testing.assert_allclose(motion.moved(black(points)).points, points, atol=3e-4)


def test_hidden_points_do_not_move_the_others():
    """A side of the plate has no partner, but something else is 3 cm below it."""
    points = plate()
    points[:40, 2] += 0.03
    motion, _ = aligned_to_plate(points)
    np.testing.assert_allclose(motion.moved(black(points)).points, points, atol=1e-6)


def test_a_plate_is_registered_along_its_surface():
    """The distances along its normals are zero from the start."""
    motion, residual = aligned_to_plate(plate() + np.array([0.003, 0.002, 0]))
    np.testing.assert_allclose(motion.shift, [-0.003, -0.002, 0], atol=1e-6)
    assert residual < 1e-6


def test_points_far_from_the_surface_do_not_pull_but_count_as_a_misfit():
    """Half of the points are far beside the plate, in its plane."""
    motion, residual = aligned_to_plate(np.concatenate([plate(), plate() + np.array([0.2, 0.1, 0])]))
    np.testing.assert_allclose(motion.shift, 0, atol=1e-9)
    np.testing.assert_allclose(motion.rotation, np.eye(3), atol=1e-9)
    assert np.isclose(residual, FARTHEST / 2)


def test_an_imprecise_frame_does_not_spoil_the_next():
    """The frame after it is registered to the points of both, and fits those of the first exactly."""
    motions = [turned(3.0 * frame, (0.003 * frame, 0, 0)) for frame in range(3)]
    clouds = [seen(motion).part(np.arange(0, len(surface()[0]), 4)) for motion in motions]
    clouds[1].points[:] += np.random.default_rng(0).normal(0, 0.002, clouds[1].points.shape)
    (group,) = linked_frames(clouds)
    np.testing.assert_allclose(group[2].rotation, motions[2].rotation, atol=1e-4)
    np.testing.assert_allclose(group[2].shift, motions[2].shift, atol=1e-4)


def test_frames_are_linked_until_the_motion_is_unknown():
    few = seen(REST).part(np.arange(LEAST_POINTS - 1))
    other = Cloud(3 * seen(REST).points, seen(REST).colours)
    groups = linked_frames([seen(REST), seen(turned(5)), few, seen(turned(10)), other, other])
    assert [[*group] for group in groups] == [[0, 1, 3], [4, 5]]
    np.testing.assert_allclose(groups[0][3].rotation, turned(10).rotation, atol=0.02)
    assert linked_frames([few, few]) == []


@pytest.mark.parametrize("table", [0.0, 0.3])
@pytest.mark.parametrize(("axis", "height", "feet"), [("z", 0.0, True), ("x", 0.0, False), ("z", 0.1, False)])
def test_standing_objects_have_feet_unless_they_turn_over(axis: str, height: float, feet: bool, table: float):
    motions = {frame: turned(20.0 * frame, axis=axis) for frame in range(3)}
    points = np.array([[0.0, 0.0, 0.01], [0.01, 0.0, 0.04]]) + np.array([0, 0, height + table])
    moved = [motion.moved(Cloud(points, points)).points for motion in motions.values()]
    found = fused_points(moved, motions, table=table)
    assert len(found) == (12 if feet else 6)
    np.testing.assert_allclose(found[:6], np.tile(points, (3, 1)), atol=1e-12)
    if feet:
        np.testing.assert_allclose(found[6:, 2], table, atol=1e-12)


def test_boxes_become_those_of_the_whole_object():
    # Something in front hides all but 6.5 of its 8 cm, others in every frame.
    motions = [turned(4.0 * frame, (0.01 * frame, 0.0, 0.4)) for frame in range(8)]
    clouds = []
    for frame, motion in enumerate(motions):
        cloud, hidden = seen(motion), 0.0025 * frame - 0.0425
        along = motion.inverse.moved(cloud).points[:, 0]
        clouds.append(cloud.part((along > hidden) & (along < hidden + 0.065)))
    width = max(len(cloud.points) for cloud in clouds)
    points, rgb, owners = np.zeros((8, width, 3)), np.zeros((8, width, 3)), np.zeros((8, width), int)
    for frame, cloud in enumerate(clouds):
        points[frame, : len(cloud.points)], owners[frame, : len(cloud.points)] = cloud.points, 1
        rgb[frame, : len(cloud.points)] = cloud.colours / 0.15
    arrays = tuple(torch.from_numpy(value)[None, :, None, None] for value in (points, rgb, owners))
    first = torch.zeros(1, 8, 1, 3), torch.eye(3).expand(1, 8, 1, 3, 3)
    middle, rotation = (
        value[0, :, 0].numpy() for value in boxes_over_time(arrays[0], arrays[1], arrays[2], first, table=0.0)
    )
    whole = np.array([motion.shift for motion in motions])
    visible = np.array([(cloud.points.min(axis=0) + cloud.points.max(axis=0)) / 2 for cloud in clouds])
    assert np.linalg.norm(middle - whole, axis=1).max() < 0.003
    assert np.linalg.norm(visible - whole, axis=1)[[0, -1]].min() > 0.006
    # Each axis is one of the box's, and keeps its name from frame to frame.
    along = np.abs(np.stack([motion.rotation for motion in motions]).transpose(0, 2, 1) @ rotation)
    assert along.max(axis=1).min() > 0.995
    steps = np.einsum("fij,fij->f", rotation[1:], rotation[:-1])
    assert steps.min() > 1 + 2 * np.cos(np.radians(20))


def test_boxes_of_few_points_stay():
    few = torch.rand(1, 2, 1, 1, 5, 3)
    first = torch.rand(1, 2, 1, 3), torch.eye(3).expand(1, 2, 1, 3, 3)
    found = boxes_over_time(few, few, torch.ones(1, 2, 1, 1, 5, dtype=torch.int64), first, table=0.0)
    assert all(torch.equal(*pair) for pair in zip(found, first, strict=True))


def box_of_image(places: np.ndarray, own: np.ndarray, *, table: float) -> tuple[np.ndarray, np.ndarray]:
    """T and R of the only object of a black image."""
    points, owners = (torch.from_numpy(value)[None, None] for value in (places, own.astype(int)))
    first = torch.zeros(1, 1, 1, 3), torch.eye(3).expand(1, 1, 1, 3, 3)
    middle, rotation = boxes_over_time(points, torch.zeros_like(points), owners, first, table=table)
    return middle[0, 0, 0].numpy(), rotation[0, 0, 0].numpy()


def grid(spacing: float, slope: float = 0.0) -> np.ndarray:
    """Image of a plane, 8 by 10 pixels, 5 cm high at the left."""
    y, x = np.mgrid[:8, :10] * spacing
    return np.stack([x, y, 0.05 + slope * x], axis=-1)[None]


@pytest.mark.parametrize(("spacing", "beyond"), [(0.01, 0.005), (0.04, 0.0075)])
def test_objects_end_half_a_pixel_beyond_their_border(spacing: float, beyond: float):
    own = np.zeros((1, 8, 10), bool)
    own[0, 2:6, 3:7] = True
    places = grid(spacing, slope=0.5)
    found = border_points(places, own)
    assert len(found) == 16
    np.testing.assert_allclose(np.unique(found[:, 2]), np.unique(places[own][:, 2]))
    np.testing.assert_allclose(found.min(axis=0)[:2], spacing * np.array([3, 2]) - beyond, atol=1e-9)
    np.testing.assert_allclose(found.max(axis=0)[:2], spacing * np.array([6, 5]) + beyond, atol=1e-9)


def test_the_border_of_an_image_is_not_that_of_an_object():
    assert len(border_points(grid(0.01), np.ones((1, 8, 10), bool))) == 0


def test_the_middle_of_a_box_counts_half_pixels_beyond_the_border():
    """On the left, the object leaves the image."""
    own = np.zeros((1, 8, 10), bool)
    own[0, 1:7, 0:9] = True
    middle, _ = box_of_image(grid(0.01), own, table=0.0)
    np.testing.assert_allclose(middle[:2], [0.0425, 0.035], atol=1e-4)


def test_the_border_does_not_tilt_a_sloping_plate():
    """Points beyond the border are level with it, so that a box around them would have another slope."""
    own = np.zeros((1, 8, 10), bool)
    own[0, 1:7, 4:7] = True
    _, rotation = box_of_image(grid(0.01, slope=1.0), own, table=-1.0)
    assert np.abs(rotation.T @ [1, 0, 1]).max() > np.sqrt(2) * np.cos(np.radians(2))


def test_a_box_turns_by_less_than_a_degree_with_its_object():
    """The upright box is only 1.5 % larger."""
    block = np.stack(np.meshgrid([-0.03, 0, 0.03], [-0.02, 0, 0.02], [0, 0.02, 0.04]), axis=-1).reshape(1, 3, 9, 3)
    _, rotation = box_of_image(block @ turned(0.4).rotation.T, np.ones((1, 3, 9), bool), table=-1.0)
    assert np.degrees(Rotation.from_matrix(rotation).magnitude()) == pytest.approx(0.4, abs=0.1)


def test_axes_keep_their_names_where_motion_is_not_known():
    """A quarter turn of a box about its own axis only renames the others."""
    few, nowhere = torch.rand(1, 2, 1, 1, 5, 3), torch.zeros(1, 2, 1, 3)
    named = [torch.from_numpy(turned(degrees).rotation).float() for degrees in (0, 95, 5)]
    first = nowhere, torch.stack(named[:2])[None, :, None]
    _, found = boxes_over_time(few, few, torch.ones(1, 2, 1, 1, 5, dtype=torch.int64), first, table=0.0)
    torch.testing.assert_close(found[0, :, 0], torch.stack([named[0], named[2]]))
