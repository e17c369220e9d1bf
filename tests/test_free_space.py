"""Space that a camera saw through, in scenes computed by hand."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.geometry.free_space import FreeSpace


def wall(depth: float) -> np.ndarray:
    """Points [N, 3] 5 mm apart on a square of 40 cm, perpendicular to the camera's z axis."""
    side = np.arange(-0.2, 0.2001, 0.005)
    x, y = np.meshgrid(side, side)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, depth)], axis=1)


def test_free_is_what_lies_before_something_measured() -> None:
    # The camera stands at x = 2 m of the world and looks along its −x.
    turned = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    space = FreeSpace(wall(1.0), transform(turned, [2.0, 0.0, 0.0]))
    places = {
        (1.5, 0.0, 0.0): True,  # half way
        (1.5, 0.09, -0.09): True,  # the wall reaches 0.1 m to each side there
        (1.5, 0.12, 0.0): False,  # beside it nothing was measured
        (1.02, 0.0, 0.0): False,  # 2 cm before the wall
        (0.9, 0.0, 0.0): False,  # behind it
        (2.5, 0.0, 0.0): False,  # behind the camera
    }
    np.testing.assert_array_equal(space.holds(np.array([*places])), [*places.values()])


def test_of_a_camera_that_measured_nothing_no_place_is_known() -> None:
    space = FreeSpace(np.zeros((0, 3)), np.eye(4))
    assert not space.holds(np.array([[0.0, 0.0, 0.5], [0.0, 0.0, -0.5]])).any()
