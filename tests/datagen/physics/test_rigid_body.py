import os
import tempfile

import numpy as np
import pytest

from datagen.errors import DatagenError
from datagen.geometry import rotation_from_quaternion
from datagen.physics.rigid_body import multiply, principal_axes, shrink, wavefront, wavefront_file


def test_principal_axes_take_the_inertia_apart():
    rng = np.random.default_rng(0)
    for _ in range(20):
        points = rng.normal(size=(9, 3)) * [1.0, 0.6, 0.3]
        inertia = np.eye(3) * np.sum(points**2) - points.T @ points
        moments, quaternion = principal_axes(inertia)
        rotation = rotation_from_quaternion(quaternion)
        np.testing.assert_allclose(rotation @ np.diag(moments) @ rotation.T, inertia, atol=1e-12)
        assert np.linalg.det(rotation) > 0


def test_a_product_of_quaternions_is_the_product_of_their_rotations():
    a, b = np.random.default_rng(1).normal(size=(2, 4))
    product = rotation_from_quaternion(multiply(a, b))
    np.testing.assert_allclose(product, rotation_from_quaternion(a) @ rotation_from_quaternion(b), atol=1e-12)


def test_a_shrunk_box_is_smaller_by_the_margin_on_every_side():
    corners = np.array([[x, y, z] for x in (0, 0.1) for y in (-0.2, 0.2) for z in (0.3, 0.35)], float)
    small = shrink(corners, 0.001)
    np.testing.assert_allclose(np.min(small, axis=0), np.min(corners, axis=0) + 0.001)
    np.testing.assert_allclose(np.max(small, axis=0), np.max(corners, axis=0) - 0.001)


def test_a_sheet_thinner_than_the_margin_keeps_its_order():
    sheet = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.001]])
    assert np.all(np.argsort(shrink(sheet, 0.001)[:, 2]) == np.argsort(sheet[:, 2]))


def test_the_obj_text_names_every_corner_in_a_face_of_its_part():
    rng = np.random.default_rng(2)
    parts = [rng.normal(size=(count, 3)) for count in (4, 5, 6)]
    lines = [line.split() for line in wavefront(parts).splitlines()]
    corners = np.array([[float(word) for word in line[1:]] for line in lines if line[0] == "v"])
    np.testing.assert_array_equal(corners, np.concatenate(parts))
    named = [sorted({int(i) for line in part for i in line}) for part in _faces(lines)]
    assert named == [[1, 2, 3, 4], [5, 6, 7, 8, 9], [10, 11, 12, 13, 14, 15]]


def test_the_obj_file_is_there_as_long_as_it_is_needed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    parts = [np.eye(4)[:, :3]]
    with wavefront_file(parts) as path, open(path) as file:
        assert file.read() == wavefront(parts)
    assert not os.listdir(tmp_path)


def test_a_temporary_file_that_cannot_be_written_names_its_place(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with (
        pytest.raises(DatagenError, match=r"temporary file in .*missing: No such file.*TMPDIR"),
        wavefront_file([np.eye(3)]),
    ):
        pass


def _faces(lines: list[list[str]]) -> list[list[list[str]]]:
    parts: list[list[list[str]]] = []
    for line in lines:
        if line[0] == "o":
            parts.append([])
        elif line[0] == "f":
            parts[-1].append(line[1:])
    return parts
