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

_NAMES = {
    "camera.scene_file": "read_depth_image",
    "camera.view": "View",
    "errors": "InputError RgraspError",
    "geometry.isosurface": "EmptySurfaceError",
    "io.clouds": "Cloud read_cloud write_cloud",
    "io.motion_file": "write_trajectory",
    "io.plans": "read_plan write_plan",
    "models.completion": "Completion complete",
    "models.reconstruction": "Reconstruction",
    "models.registry": "load_model",
    "planning.environment": "Environment Obstacle read_environment",
    "planning.grasp_planner": "GraspPlanner PlanOptions",
    "planning.motion": "MotionConfig",
    "planning.object_choice": "TargetChoice",
    "planning.plan_on_table": "plan_on_table",
    "planning.planner": "PlannerConfig",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
