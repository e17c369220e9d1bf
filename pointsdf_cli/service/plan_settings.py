"""Settings of plans whose scenes are read from files, and the request for each scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pointsdf_cli.camera.scene_file import SceneFileOptions
from pointsdf_cli.planning.plan_request import PlanRequest, PlanResult, headline
from pointsdf_cli.planning.scene_input import read_scene
from pointsdf_cli.planning.table_top import workspace_of
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.service.identity import PlannerFiles

if TYPE_CHECKING:
    from pointsdf_cli.viz.plan_picture import PlanScene


@dataclass(frozen=True)
class PlanSettings:
    """Settings of plans, apart from a scene's own files.

    Attributes:
        request: Request for every scene, without clouds, their names and a target.
        target: --target as typed.
        files: Robot and weights.
        device: Device of the networks.
    """

    request: PlanRequest
    target: str | None
    files: PlannerFiles
    device: str = "cpu"

    def read(
        self, clouds: Sequence[Path], poses: Sequence[str], files: Sequence[SceneFileOptions]
    ) -> tuple[PlanRequest, tuple[str, ...]]:
        """The checked request for one scene, and sentences that the user should see.

        Args:
            clouds: Its views.
            poses: Their camera poses as typed, or none.
            files: Reading options of each.

        Raises:
            InputError: A file or an option cannot be used.
            NoObjectError: The target is not there, where the pose is `table`.
        """
        given = read_scene(
            clouds,
            poses,
            files,
            self.target,
            workspace_of(self.request.workspace),
            self.request.cleaned,
        )
        names = [str(path) for path in clouds]
        request = replace(self.request, clouds=given.clouds, names=names, target=given.target)
        request.check()
        return request, given.notes


def draw_plan(path: Path, result: PlanResult, robot: Path | None) -> None:
    """Draw the picture of a plan, or of the scene that has none.

    Args:
        path: PNG to write.
        result: The answer.
        robot: Its YAML; the bundled one if None.
    """
    from pointsdf_cli.viz.plan_picture import plan_picture
    from pointsdf_cli.viz.robot_picture import RobotMeshes

    plan = result.plan
    q = result.start if plan.reason else plan.q
    # The sentence holds all warnings; without a plan it stands in the headline.
    below = " ".join(([] if plan.reason else [plan.sentence]) + ["; ".join(result.report)]).strip()
    plan_picture(
        path, RobotMeshes(load_robot(robot)), q, scene_of_plan(result), headline(plan), below
    )


def scene_of_plan(result: PlanResult) -> PlanScene:
    """The scene of a plan to draw, without the robot."""
    from pointsdf_cli.planning.environment import obstacle_mesh
    from pointsdf_cli.viz.plan_picture import PlanScene

    vertices, faces = result.plan.object_vertices.astype(np.float64), result.plan.object_faces
    obstacles = [obstacle_mesh(obstacle) for obstacle in result.obstacles]
    believed = (vertices, faces) if len(faces) else None
    return PlanScene(result.points, result.camera, believed, obstacles, result.table)
