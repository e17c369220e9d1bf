"""What the simulated camera hands to the planner: the object, the table, and the space seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pointsdf_cli.geometry.frames import plane_in_camera
from pointsdf_cli.io.meshes import load_mesh
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.shading import look_at

pytest.importorskip("pybullet", reason="PyBullet has no wheel for this Python")


@pytest.mark.parametrize("sensor", ["ideal", "structured-light"])
def test_a_view_knows_the_table_and_the_space_that_was_seen_through(
    tmp_path: Path, sensor: str
) -> None:
    from pointsdf_cli.simulation.observe import CameraPlacement, Observer
    from pointsdf_cli.simulation.sim_object import prepare_object

    trimesh.creation.box((0.06, 0.08, 0.12)).export(tmp_path / "box.ply")
    item = prepare_object(load_mesh(tmp_path / "box.ply"))
    stands = np.eye(4)
    stands[:3, 3] = (0.65, 0.0, 0.06)
    camera = look_at(np.array([1.5, 0.3, 0.7]), stands[:3, 3])
    observer = Observer(load_robot(), CameraPlacement(sensor=sensor))
    view = observer.object_view(item, stands, camera, np.random.default_rng(0))
    points = view.in_world - stands[:3, 3]
    assert len(points) > 500
    assert (np.abs(points) < np.array([0.03, 0.04, 0.06]) + 0.012).mean() > 0.98
    evidence = view.evidence
    assert evidence is not None
    plane = evidence.support_plane
    assert plane is not None
    wanted = plane_in_camera([0, 0, 1, 0], camera)
    assert np.degrees(np.arccos(min(1.0, plane[:3] @ wanted[:3]))) < 0.6
    assert abs(plane[3] - wanted[3]) < 0.006
    image = evidence.visibility
    assert image is not None
    # Around the object the camera saw the table: free up to there.
    assert image.seen.any()
    assert (image.free[~image.seen] > 0.5).mean() > 0.5


def test_a_plane_of_the_world_as_a_camera_sees_it() -> None:
    # A camera 0.5 m above the floor that looks straight down: the floor is z = 0.5 in its frame,
    # and its normal points back at the camera.
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 0.5
    assert np.allclose(plane_in_camera([0, 0, 1, 0], down), [0, 0, -1, -0.5])
