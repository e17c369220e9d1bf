"""The near and the far wall of a bowl belong together; other things of equal height do not."""

from __future__ import annotations

import numpy as np
import pytest
import scenes

from pointsdf_cli.camera.rim import Rim, joined_at_rims, on_one_circle
from pointsdf_cli.planning.labelled_view import WORKSPACE, label_view
from pointsdf_cli.viz.shading import look_at

CAMERA = np.array([1.4, 0.0, 0.3])


def shares_rim(first: np.ndarray, second: np.ndarray) -> bool:
    return on_one_circle(Rim.of(first), Rim.of(second), CAMERA)


def wall(radius: float, near: bool, centre: tuple[float, float] = (0.6, 0.0)) -> np.ndarray:
    """Points [N, 3] of the half of an upright tube, 6 cm high, that is nearer to or farther from
    the camera."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, 80) + (0.0 if near else np.pi)
    height = np.linspace(0.002, 0.06, 24)
    turn, height = (x.ravel() for x in np.meshgrid(turn, height))
    x, y = radius * np.cos(turn) + centre[0], radius * np.sin(turn) + centre[1]
    return np.stack([x, y, height], axis=1)


def test_walls_of_one_tube_share_a_rim() -> None:
    near, far = wall(0.07, near=True), wall(0.066, near=False)
    assert shares_rim(near, far)
    assert shares_rim(far, near)
    label = np.repeat([4, 7, 2], [len(near), len(far), len(near)])
    points = np.concatenate([near, far, near + (0.0, 0.3, 0.0)])
    joined = joined_at_rims(points, label, [2, 4, 7], CAMERA)
    np.testing.assert_array_equal(joined, np.where(label == 7, 4, label))


def test_other_parts_share_none() -> None:
    near, far = wall(0.07, near=True), wall(0.066, near=False)
    assert not shares_rim(near, far + (0.0, 0.0, 0.02))  # higher
    assert not shares_rim(near, far + (-0.04, 0.0, 0.0))  # farther away
    assert not shares_rim(near, wall(0.07, near=True, centre=(0.45, 0.0)))  # one behind
    assert not shares_rim(near[:, [0, 1, 2]] * (1, 0.2, 1), far * (1, 0.2, 1))  # flat
    rng = np.random.default_rng(0)
    top = np.concatenate([rng.uniform(-0.07, 0.07, (2000, 2)), np.full((2000, 1), 0.06)], axis=1)
    top = top[np.linalg.norm(top[:, :2], axis=1) < 0.07] + (0.6, 0.0, 0.0)
    assert not shares_rim(np.concatenate([near, top[top[:, 0] > 0.6]]), far)  # a full can


@pytest.mark.parametrize("height", [0.25, 0.32, 0.45])
def test_a_bowl_seen_from_the_side_is_one_object(height: float) -> None:
    pose = look_at((1.3, 0.1, height), (0.6, 0.0, 0.03))
    for radius, high in ((0.08, 0.055), (0.11, 0.07)):
        depth = scenes.seen(scenes.table(), scenes.bowl((0.6, 0.0), radius, high), pose=pose)
        (one,) = label_view(scenes.cloud(depth, pose), "a", WORKSPACE).listed
        assert one.size[:2] == pytest.approx((2 * radius, 2 * radius), abs=0.015)
        assert not one.unsplit


def test_cans_of_equal_height_are_two_objects() -> None:
    pose = look_at((1.3, 0.0, 0.35), (0.6, 0.0, 0.03))
    cans = scenes.can(0.035, 0.08, (0.6, 0.0)), scenes.can(0.035, 0.08, (0.505, 0.02))
    view = scenes.cloud(scenes.seen(scenes.table(), *cans, pose=pose), pose)
    assert len(label_view(view, "a", WORKSPACE).listed) == 2
