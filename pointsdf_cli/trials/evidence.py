"""Evidence of a trial: the data of its picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.camera.view import View
from pointsdf_cli.geometry.arrays import Array, Surface
from pointsdf_cli.io.plans import Plan
from pointsdf_cli.io.trials import Evidence
from pointsdf_cli.planning.environment import Obstacle, obstacle_mesh
from pointsdf_cli.trials.execution import Executed

SHOWN_POINTS = 1500
SHOWN_FACES = 4000


def evidence_of(
    view: View,
    poses: Sequence[Array],
    believed: Surface | None,
    plan: Plan | None,
    executed: Executed | None,
    home: Array,
    obstacles: Sequence[Obstacle],
) -> Evidence:
    """The evidence of one trial.

    Args:
        view: The target's seen points.
        poses: T_world_object [4, 4] of the target, then of each other object.
        believed: The target's surface in the planner.
        plan, executed: Plan and execution; None without them.
        home: [J], home configuration of the robot.
        obstacles: The other objects in the planner.
    """
    nothing = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32)
    vertices, faces = _few_faces(*(nothing if believed is None else believed))
    stride = max(1, len(view.points) // SHOWN_POINTS)
    placed = np.array(poses, dtype=np.float64)
    target, standing = placed[0], placed[1:]
    if plan is not None and executed is not None:
        moments = executed.moments
        phases = ("planned", *(m.phase for m in moments))
        q = np.stack([plan.q, *(m.q for m in moments)])
        objects = np.stack([target, *(m.T_world_object for m in moments)])
        others = np.stack([standing, *(m.T_world_others for m in moments)])
    else:
        phases, q = ("home",), home[None]
        objects, others = target[None], standing[None]
    return Evidence(
        cloud=view.in_world[::stride].astype(np.float32),
        T_world_camera=view.T_world_camera,
        vertices=np.asarray(vertices, dtype=np.float32),
        faces=np.asarray(faces, dtype=np.int32),
        phases=phases,
        q=q,
        T_world_object=objects,
        trajectory=np.zeros((0, len(home))) if plan is None else plan.trajectory,
        times=np.zeros(0) if plan is None else plan.times,
        T_world_others=others,
        **_joined(obstacles),
    )


def _joined(obstacles: Sequence[Obstacle]) -> dict[str, Any]:
    """All obstacles as one surface."""
    vertices, faces, start = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=np.int64)], 0
    for corners, triangles in map(obstacle_mesh, obstacles):
        vertices.append(corners)
        faces.append(triangles + start)
        start += len(corners)
    return {
        "obstacle_vertices": np.concatenate(vertices).astype(np.float32),
        "obstacle_faces": np.concatenate(faces).astype(np.int32),
    }


def _few_faces(vertices: Array, faces: NDArray[np.integer]) -> tuple[Any, Any]:
    if len(faces) <= SHOWN_FACES:
        return vertices, faces
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh = mesh.simplify_quadric_decimation(face_count=SHOWN_FACES)
    return mesh.vertices, mesh.faces
