"""HDF5 artifacts: one small good file of each schema, read, described and shown as commands do."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from plan_files import turning_plan
from trial_rows import ROW

from pointsdf_cli.io.describe import describe
from pointsdf_cli.io.grasp_evidence import Evidence as GraspEvidence
from pointsdf_cli.io.grasp_evidence import join_evidence, read_evidence, write_evidence
from pointsdf_cli.io.grasps import Grasps, GraspsMeta, collection_of, read_grasps, write_grasps
from pointsdf_cli.io.hdf5 import is_complete, open_hdf5, options_of
from pointsdf_cli.io.labels import Labels, read_labels, write_labels
from pointsdf_cli.io.plans import plan_as_json, read_plan, write_plan
from pointsdf_cli.io.trials import (
    TRIAL_VERSION,
    Evidence,
    read_trial,
    read_trials,
    write_trial,
    write_trials,
)
from pointsdf_cli.io.views import Views, read_views, read_views_header, write_views
from pointsdf_cli.robot.description import RobotDescription, load_robot
from pointsdf_cli.trials.pictures import caption
from pointsdf_cli.trials.report import markdown_report
from pointsdf_cli.trials.summary import summarise
from pointsdf_cli.viz.artifact_scene import scene_of
from pointsdf_cli.viz.data_report import DataFolder, data_report
from pointsdf_cli.viz.grasp_report import grasp_report
from pointsdf_cli.viz.html_scene import scene_page
from pointsdf_cli.viz.plan_report import plan_report
from pointsdf_cli.viz.scene_sources import SceneOptions, mesh_folders, meshes_below

ROBOTS = Path(__file__).resolve().parents[1] / "robots"


@cache
def robot() -> RobotDescription:
    """A small robot, whose artifacts these are."""
    return load_robot(ROBOTS / "gripper.yaml")


def _shown(path: Path) -> object:
    """As `info` and `view` show it."""
    return describe(path), scene_page(scene_of(path, SceneOptions(robot(), most=3)))


def _views(path: Path) -> object:
    read_views_header(path)
    views = read_views(path)
    found = DataFolder([path], [], list(meshes_below(*mesh_folders(path))))
    return _shown(path), data_report(found, "t"), views.cloud.mean()


def _labels(path: Path) -> object:
    labels = read_labels(path)
    return _shown(path), labels.points.mean(axis=1) + labels.sdf


def _grasps(path: Path) -> object:
    grasps, meta = read_grasps(path)
    page = grasp_report([("m", grasps, meta)], [], [], "t")
    return _shown(path), page, grasps.count(), collection_of(path)


def _plan(path: Path) -> object:
    plan = read_plan(path)
    # The page's pictures take a second; whether there are any depends on the motion alone.
    page = plan_report(plan, robot(), "t") if not len(plan.times) else ""
    return _shown(path), plan_as_json(plan), page


def _trial(path: Path) -> object:
    is_complete(path, schema="trial", version=TRIAL_VERSION, config=_options(path))
    row, evidence = read_trial(path)
    return _shown(path), caption(row), evidence.T_world_object[-1] @ np.eye(4)


def _options(path: Path) -> dict[str, object]:
    with open_hdf5(path) as file:
        return options_of(file)


def _trials(path: Path) -> object:
    rows = read_trials(path)
    return describe(path), summarise(rows), markdown_report(rows, "t")


def _evidence(path: Path) -> object:
    evidence = read_evidence(path)
    return describe(path), join_evidence([evidence, evidence])


ARTIFACTS: dict[str, Callable[[Path], object]] = {
    "views.h5": _views,
    "labels.h5": _labels,
    "grasps.h5": _grasps,
    "plan.h5": _plan,
    "trial.h5": _trial,
    "trials.h5": _trials,
    "grasp_evidence.h5": _evidence,
}


def write_artifacts(folder: Path, points: np.ndarray) -> None:
    """Write one good file of each schema."""
    poses = np.tile(np.eye(4), (2, 1, 1))
    clouds = np.stack([points, points]).astype(np.float32)
    digest, camera = "0" * 64, np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
    write_views(
        folder / "views.h5", Views(clouds, poses, camera, (64, 48), 0.001, "m", digest), seed=0
    )
    sdf = np.linspace(-0.1, 0.1, 60, dtype=np.float32)
    write_labels(folder / "labels.h5", Labels(clouds[0], sdf, "m", digest), seed=0)
    q, names = np.tile(robot().home, (2, 1)), robot().joint_names
    one, number = np.ones(2, np.int8), np.ones(2, np.int32)
    grasps = Grasps(
        clouds, poses, poses, poses, q, one, one, one, sdf[:2], sdf[:2], number, number, one,
    )  # fmt: skip
    meta = GraspsMeta("m", digest, "train", "gripper", names, ("left_jaw",))
    write_grasps(folder / "grasps.h5", grasps, meta, seed=0)
    write_plan(folder / "plan.h5", turning_plan(robot(), steps=3), seed=0)
    corners = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]], np.int32)
    seen = Evidence(
        clouds[0], np.eye(4), clouds[0, :4], corners, ("planned", "end"), q, poses, q,
        np.arange(2.0),
    )  # fmt: skip
    write_trial(folder / "trial.h5", ROW, seen, {"seed": 0})
    write_trials(folder / "trials.h5", [ROW, ROW], seed=0, config={})
    write_evidence(
        folder / "grasp_evidence.h5",
        GraspEvidence(
            clouds[:, 0], clouds[:, 1].astype(np.float64), np.ones(2), clouds[:, 2],
            clouds[:, 3], clouds[:, 4],
        ),
        "key",
    )  # fmt: skip
