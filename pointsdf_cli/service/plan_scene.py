"""The scene of a plan, for its picture."""

from __future__ import annotations

import numpy as np

from pointsdf_cli.planning.obstacle_mesh import obstacle_mesh
from pointsdf_cli.planning.plan_request import PlanResult
from pointsdf_cli.viz.plan_picture import PlanScene


def scene_of_plan(result: PlanResult) -> PlanScene:
    """The scene of a plan to draw, without the robot."""
    believed = (result.plan.object_vertices.astype(np.float64), result.plan.object_faces)
    return PlanScene(
        result.points,
        result.camera,
        believed if len(result.plan.object_faces) else None,
        [obstacle_mesh(obstacle) for obstacle in result.obstacles],
    )
