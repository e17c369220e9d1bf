"""Poses in another convention, recognised by the table that the camera sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_planning_table_top import POSE, TABLE, THINGS, cloud

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import (
    apply_transform,
    invert_transform,
    rotation_from_wxyz,
    transform,
    wxyz_from_rotation,
)
from pointsdf_cli.io.clouds import Cloud
from pointsdf_cli.io.poses import camera_pose
from pointsdf_cli.planning.pose_mistakes import (
    BODY_AXES,
    GRAPHICS_AXES,
    require_no_mistaken_pose,
)

WXYZ = wxyz_from_rotation(POSE[:3, :3])


def seen(pose: np.ndarray) -> Cloud:
    """What the camera at `POSE` sees, with another pose written beside it."""
    points = apply_transform(invert_transform(POSE), np.concatenate([TABLE, THINGS]))
    return replace(cloud(np.concatenate([TABLE, THINGS])), points=points, T_world_camera=pose)


def test_the_right_pose_passes() -> None:
    require_no_mistaken_pose(seen(POSE), "depth.png")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (transform(rotation_from_wxyz([*WXYZ[1:], WXYZ[0]]), POSE[:3, 3]), "x,y,z,w"),
        (invert_transform(POSE), "inverse"),
        (transform(POSE[:3, :3] @ BODY_AXES.T, POSE[:3, 3]), "body"),
        (transform(POSE[:3, :3] @ GRAPHICS_AXES.T, POSE[:3, 3]), "graphics"),
        (transform(POSE[:3, :3] @ np.diag([-1, -1, 1]), POSE[:3, 3]), "upside down"),
        (transform(POSE[:3, :3].T, POSE[:3, 3]), "transposed"),
    ],
)
def test_a_mistaken_convention_is_named_and_the_pose_to_type_is_right(
    given: np.ndarray, said: str
) -> None:
    with pytest.raises(InputError) as caught:
        require_no_mistaken_pose(seen(given), "depth.png")
    assert said in caught.value.what
    assert caught.value.hint is not None
    typed = camera_pose(caught.value.hint.removeprefix("--camera-pose "))
    in_world = apply_transform(typed, seen(POSE).points)
    table = in_world[: len(TABLE)]
    assert np.abs(table[:, 2]).max() < 0.03


def test_a_pose_that_no_convention_explains_passes() -> None:
    tipped = POSE.copy()
    tipped[:3, :3] = rotation_from_wxyz([0.9, 0.3, 0.3, 0.1]) @ tipped[:3, :3]
    require_no_mistaken_pose(seen(tipped), "depth.png")
    bare = replace(seen(invert_transform(POSE)), points=seen(POSE).points[len(TABLE) :])
    require_no_mistaken_pose(bare, "object.ply")


def test_a_camera_in_millimetres_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"(?s)the camera is 583\.1 m away.*up to 50 m.*millimetres"
    ):
        camera_pose("500,0,300,1,0,0,0")
    assert camera_pose("0.5,0,0.3,1,0,0,0")[2, 3] == 0.3


def test_an_inverted_pose_of_points_in_the_world_is_refused() -> None:
    world = np.concatenate([TABLE, THINGS])
    scene = Cloud(world, frame="world", T_world_camera=invert_transform(POSE))
    with pytest.raises(InputError, match="inverse faces them") as caught:
        require_no_mistaken_pose(scene, "cloud.ply")
    typed = camera_pose(str(caught.value.hint).removeprefix("--camera-pose "))
    np.testing.assert_allclose(typed, POSE, atol=1e-4)


@pytest.mark.parametrize("axes", [np.eye(3), BODY_AXES.T, GRAPHICS_AXES, POSE[:3, :3].T])
def test_a_right_eye_of_points_in_the_world_passes(axes: np.ndarray) -> None:
    # A PCD's VIEWPOINT often has the eye alone, or axes of another convention.
    for pose in (transform(POSE[:3, :3] @ axes, POSE[:3, 3]), transform(axes, POSE[:3, 3])):
        for world in (np.concatenate([TABLE, THINGS]), THINGS, THINGS[: len(THINGS) // 2]):
            require_no_mistaken_pose(Cloud(world, frame="world", T_world_camera=pose), "a.pcd")
