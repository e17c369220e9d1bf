"""Transforms against values computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pointsdf_cli.geometry.frames import (
    apply_transform,
    invert_transform,
    is_rigid,
    random_rotation,
    rotation_from_wxyz,
    rotation_vector,
    transform,
    wxyz_from_rotation,
)

QUARTER_TURN_ABOUT_Z = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


def test_a_quarter_turn_about_z_takes_x_to_y_then_shifts() -> None:
    T = transform(QUARTER_TURN_ABOUT_Z, [10, 20, 30])
    np.testing.assert_allclose(apply_transform(T, [[1, 0, 0]]), [[10, 21, 30]])


def test_the_quaternion_of_a_quarter_turn_about_z_is_known() -> None:
    half = np.sqrt(0.5)
    np.testing.assert_allclose(wxyz_from_rotation(QUARTER_TURN_ABOUT_Z), [half, 0, 0, half])
    np.testing.assert_allclose(
        rotation_from_wxyz([half, 0, 0, half]), QUARTER_TURN_ABOUT_Z, atol=1e-15
    )


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_have_quaternions_although_their_scalar_is_zero(axis: int) -> None:
    rotation = -np.eye(3)
    rotation[axis, axis] = 1
    expected = np.zeros(4)
    expected[1 + axis] = 1
    np.testing.assert_allclose(np.abs(wxyz_from_rotation(rotation)), expected, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_quaternions_and_rotations_go_round(seed: int) -> None:
    rotations = random_rotation(np.random.default_rng(seed), 8)
    np.testing.assert_allclose(
        rotation_from_wxyz(wxyz_from_rotation(rotations)), rotations, atol=1e-12
    )


def test_inverse_undoes_a_batch() -> None:
    rng = np.random.default_rng(0)
    T = transform(random_rotation(rng, 5), rng.normal(size=(5, 3)))
    np.testing.assert_allclose(
        T @ invert_transform(T), np.broadcast_to(np.eye(4), (5, 4, 4)), atol=1e-12
    )


def test_random_rotations_are_uniform() -> None:
    # Uniform over SO(3): each axis is uniform on the sphere, so its z has mean 0, variance 1/3.
    z = random_rotation(np.random.default_rng(1), 20_000)[:, 2, :]
    assert np.abs(z.mean(axis=0)).max() < 0.015
    assert np.abs(z.var(axis=0) - 1 / 3).max() < 0.01


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, 1, -1, 1]),
        np.diag([2.0, 2, 2, 1]),
        np.full((4, 4), np.nan),
        np.eye(3),
        np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1.0]]),
    ],
    ids=["mirror", "scale", "nan", "3x3", "projective"],
)
def test_what_is_not_rigid_is_known(matrix: np.ndarray) -> None:
    assert not is_rigid(matrix)


def test_a_rotation_with_a_shift_is_rigid() -> None:
    assert is_rigid(transform(QUARTER_TURN_ABOUT_Z, [1, 2, 3]))


def test_rotation_vectors_are_scipys_and_small_ones_the_skew_part() -> None:
    rotations = random_rotation(np.random.default_rng(4), 50).reshape(5, 10, 3, 3)
    expected = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_rotvec().reshape(5, 10, 3)
    np.testing.assert_allclose(rotation_vector(rotations), expected, atol=1e-7)
    tiny = np.array([3e-8, -1e-8, 2e-8])
    np.testing.assert_allclose(
        rotation_vector(Rotation.from_rotvec(tiny).as_matrix()), tiny, atol=1e-15
    )
    np.testing.assert_array_equal(rotation_vector(np.eye(3)), np.zeros(3))
