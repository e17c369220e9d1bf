"""rgrasp: from one partial point cloud to a grasp of an object that nobody has modelled.

The public functions, each loaded when it is first asked for:

    from pointsdf_cli import complete, read_cloud
    points, _ = read_cloud("assets/clouds/mug.ply").in_camera_frame()
    shape = complete(points)      # vertices, faces, sdf(x), gradient(x)
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pointsdf_cli.camera.scene_file import read_depth_image as read_depth_image
    from pointsdf_cli.camera.view import View as View
    from pointsdf_cli.errors import InputError as InputError
    from pointsdf_cli.errors import RgraspError as RgraspError
    from pointsdf_cli.geometry.isosurface import EmptySurfaceError as EmptySurfaceError
    from pointsdf_cli.io.clouds import Cloud as Cloud
    from pointsdf_cli.io.clouds import read_cloud as read_cloud
    from pointsdf_cli.io.clouds import write_cloud as write_cloud
    from pointsdf_cli.io.motion_file import write_trajectory as write_trajectory
    from pointsdf_cli.io.plans import read_plan as read_plan
    from pointsdf_cli.io.plans import write_plan as write_plan
    from pointsdf_cli.models.completion import Completion as Completion
    from pointsdf_cli.models.completion import complete as complete
    from pointsdf_cli.models.reconstruction import Reconstruction as Reconstruction
    from pointsdf_cli.models.registry import load_model as load_model
    from pointsdf_cli.planning.environment import Environment as Environment
    from pointsdf_cli.planning.environment import Obstacle as Obstacle
    from pointsdf_cli.planning.environment import read_environment as read_environment
    from pointsdf_cli.planning.grasp_planner import GraspPlanner as GraspPlanner
    from pointsdf_cli.planning.grasp_planner import PlanOptions as PlanOptions
    from pointsdf_cli.planning.motion import MotionConfig as MotionConfig
    from pointsdf_cli.planning.object_choice import TargetChoice as TargetChoice
    from pointsdf_cli.planning.plan_on_table import plan_on_table as plan_on_table
    from pointsdf_cli.planning.planner import PlannerConfig as PlannerConfig

__version__ = "0.1.0"

_HOMES = {
    "read_depth_image": "camera.scene_file",
    "View": "camera.view",
    "InputError": "errors",
    "RgraspError": "errors",
    "EmptySurfaceError": "geometry.isosurface",
    "Cloud": "io.clouds",
    "read_cloud": "io.clouds",
    "write_cloud": "io.clouds",
    "write_trajectory": "io.motion_file",
    "read_plan": "io.plans",
    "write_plan": "io.plans",
    "Completion": "models.completion",
    "complete": "models.completion",
    "Reconstruction": "models.reconstruction",
    "load_model": "models.registry",
    "Environment": "planning.environment",
    "Obstacle": "planning.environment",
    "read_environment": "planning.environment",
    "GraspPlanner": "planning.grasp_planner",
    "PlanOptions": "planning.grasp_planner",
    "MotionConfig": "planning.motion",
    "TargetChoice": "planning.object_choice",
    "plan_on_table": "planning.plan_on_table",
    "PlannerConfig": "planning.planner",
}
__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
