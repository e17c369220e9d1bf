"""Scenes of any artifact, and of several in one world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.clouds import CLOUD_SUFFIXES, read_cloud
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.grasp_scenes import grasps_scene, plan_scene, trial_scene
from pointsdf_cli.viz.robot_check_picture import robot_scene
from pointsdf_cli.viz.scene import Scene, joined
from pointsdf_cli.viz.scene_sources import SceneOptions, kind_of
from pointsdf_cli.viz.shape_scenes import (
    cloud_place,
    cloud_scene,
    labels_scene,
    mesh_scene,
    views_scene,
)


def scene_of(path: Path, options: SceneOptions) -> Scene:
    """Make the scene of an artifact in the world's frame (mesh, views and labels: the mesh's).

    Raises:
        InputError: The file does not exist, or is of a kind that cannot be shown.
    """
    return _SCENES[kind_of(path)](path, options)


def scenes_of(paths: Sequence[Path], options: SceneOptions) -> Scene:
    """Make one scene of several artifacts in one world.

    A mesh beside a cloud is assumed to be in the cloud's frame, as `rgrasp mesh` writes it.

    Raises:
        InputError: An artifact cannot be shown, or two of them move.
    """
    scenes, T_world_mesh = [scene_of(path, options) for path in paths], np.eye(4)
    for path, scene in zip(paths, scenes, strict=True):
        still_cloud = any(part.layer == "cloud" and part.frame is None for part in scene.parts)
        if still_cloud and path.suffix.lower() in CLOUD_SUFFIXES:
            T_world_mesh = cloud_place(read_cloud(path, options.unit, drop_invalid=True))
            break
    return joined([_set_down(scene, T_world_mesh) for scene in scenes])


def _robot(path: Path, options: SceneOptions) -> Scene:
    return robot_scene(load_robot(path), path.name)


_SCENES = {
    "cloud": cloud_scene,
    "mesh": mesh_scene,
    "robot": _robot,
    "views": views_scene,
    "labels": labels_scene,
    "grasps": grasps_scene,
    "plan": plan_scene,
    "trial": trial_scene,
}


def _set_down(scene: Scene, T_world_mesh: NDArray[np.float64]) -> Scene:
    """A scene of meshes alone, moved as a whole; any other as it is."""
    if any(part.layer not in ("mesh", "axes") for part in scene.parts):
        return scene
    parts = tuple(
        replace(part, vertices=apply_transform(T_world_mesh, part.vertices)) for part in scene.parts
    )
    return replace(scene, parts=parts)
