"""Scenes of any artifact, and of several in one world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.clouds import read_cloud
from pointsdf_cli.io.ply import ply_comments
from pointsdf_cli.io.raw_cloud import pose_of_header
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.grasp_scenes import grasps_scene, plan_scene, trial_scene
from pointsdf_cli.viz.robot_check_picture import robot_scene
from pointsdf_cli.viz.scene import Scene, joined
from pointsdf_cli.viz.scene_sources import SceneOptions, kind_of
from pointsdf_cli.viz.shape_scenes import (
    T_UPRIGHT_CAMERA,
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

    A mesh lies where its PLY header says, as `rgrasp mesh` writes it; one that says nothing is
    assumed to be in the frame of the first cloud. A guess that may be wrong is a fact "warning".

    Raises:
        InputError: An artifact cannot be shown, or two of them move.
    """
    scenes, kinds = [scene_of(path, options) for path in paths], [kind_of(path) for path in paths]
    clouds = [path for path, kind in zip(paths, kinds, strict=True) if kind == "cloud"]
    places = [cloud_place(read_cloud(path, options.unit, drop_invalid=True)) for path in clouds]
    # Views and labels are in the frame of their mesh.
    if set(kinds) != {"mesh"} and not {"views", "labels"} & set(kinds):
        for k in [k for k, kind in enumerate(kinds) if kind == "mesh"]:
            scenes[k] = _set_down(scenes[k], paths[k], places)
    return joined(scenes)


_SCENES = {
    "cloud": cloud_scene,
    "mesh": mesh_scene,
    "robot": lambda path, _: robot_scene(load_robot(path), path.name),
    "views": views_scene,
    "labels": labels_scene,
    "grasps": grasps_scene,
    "plan": plan_scene,
    "trial": trial_scene,
}


def _set_down(scene: Scene, path: Path, places: list[NDArray[np.float64]]) -> Scene:
    """The scene of a mesh, moved into the world shown; `places` are the poses [4, 4] of the frames
    of the clouds beside it."""
    comments, warning = ply_comments(path) if path.suffix.lower() == ".ply" else {}, ""
    place = np.eye(4) if comments.get("frame") == "world" else pose_of_header(comments, path)
    if place is None or any(other is T_UPRIGHT_CAMERA for other in places):
        place = places[0] if places else np.eye(4)
        if not places:
            warning = "does not say where it lies (rgrasp mesh --camera-pose writes it into a PLY)"
        elif not all(np.allclose(other, place) for other in places):
            warning = "is shown in the first cloud's frame, which is a guess"
    facts = (*scene.facts, ("warning", f"{path.name} {warning}")) if warning else scene.facts
    parts = tuple(
        replace(part, vertices=apply_transform(place, part.vertices)) for part in scene.parts
    )
    return replace(scene, parts=parts, facts=facts)
