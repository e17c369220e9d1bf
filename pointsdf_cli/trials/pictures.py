"""Picture of a trial: the view, belief and truth, the grasp, the end."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.io.trials import Evidence, TrialRow
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.simulation.film import Moment
from pointsdf_cli.trials.summary import variant_of
from pointsdf_cli.viz.grasp_report import OBJECT_COLOUR, Film, placed, write_gif
from pointsdf_cli.viz.robot_picture import RobotMeshes
from pointsdf_cli.viz.shading import Painted, Stage, dots, look_at, table_mesh

BELIEVED_COLOUR = (0.86, 0.45, 0.20)
OTHER_COLOUR = (0.72, 0.55, 0.55)
CLOUD_COLOUR = (0.15, 0.35, 0.80)
SIZE = (260, 230)
POINT = 0.004
"""Radius of the dots that represent points [m]."""

Image = NDArray[np.uint8]


def trial_strip(
    robot: RobotMeshes, mesh: LoadedMesh, evidence: Evidence, others: Sequence[LoadedMesh] = ()
) -> Image:
    """Draw five pictures side by side [height, width, 3].

    The cloud on the true object from the camera; the reconstruction (orange) with the true object
    (green) from the robot's side; the planned grasp; the moment before the lift; the end. Other
    objects, with the meshes `others`, are drawn at their poses then, and as reconstructed.
    """
    true = placed(mesh, evidence.T_world_object[0], OBJECT_COLOUR)
    middle = (true.vertices.min(axis=0) + true.vertices.max(axis=0)) / 2
    reach = float(np.ptp(true.vertices, axis=0).max())
    eye = evidence.T_world_camera[:3, 3]
    near = middle + (eye - middle) / np.linalg.norm(eye - middle) * max(0.35, 2.2 * reach)
    table = table_mesh()
    every = evidence.T_world_others if others else [()] * len(evidence.q)
    around = [_others(others, poses) for poses in every]
    points = evidence.cloud[:: max(1, len(evidence.cloud) // 500)]
    first = [table, true, *around[0], dots(points, POINT, CLOUD_COLOUR)]
    pictures = [Stage(first).image(look_at(near, middle), SIZE)]
    behind = middle + np.array([-0.45, -0.75, 0.45]) * max(0.4, 2.2 * reach)
    pictures.append(_side_by_side(true, evidence, look_at(behind, middle), table))
    for which in _shown(evidence.phases):
        thing = placed(mesh, evidence.T_world_object[which], OBJECT_COLOUR)
        target = np.array([middle[0], middle[1], 0.13])
        camera = look_at(target + (0.42, -0.62, 0.3), target)
        parts = [*robot.at(evidence.q[which]), table, thing, *around[which]]
        pictures.append(Stage(parts).image(camera, SIZE, 0.62))
    return np.concatenate(pictures, axis=1)


def _others(meshes: Sequence[LoadedMesh], poses: Iterable[Array]) -> list[Painted]:
    """The other objects at their poses [4, 4]."""
    return [placed(mesh, T, OTHER_COLOUR) for mesh, T in zip(meshes, poses, strict=True)]


def caption(row: TrialRow) -> str:
    """One line on a trial."""
    where = f"{row.object}, yaw {np.degrees(row.yaw):.0f}°, {row.camera} camera"
    what = f"{where}, {variant_of(row)}: "
    if row.status != "ok":
        return what + f"no plan ({row.reason})"
    end = f"{row.cause}, lost in {row.lost_in}" if row.lost_in else row.cause
    facts = [f"{end}, rose {100 * row.final_height:.1f} cm", f"{row.kind} grasp"]
    if np.isfinite(row.success_probability):
        facts.append(f"predicted {row.success_probability:.2f}")
    if row.clutter:
        facts.append(f"{row.clutter} others, moved up to {1000 * row.largest_move:.0f} mm")
    if row.contact:
        facts.append(f"touched before closing, moved {1000 * row.moved:.0f} mm")
    if row.penetration > 0:
        facts.append(f"planned {1000 * row.penetration:.1f} mm into the true object")
    return what + "; ".join(facts)


def write_film(
    path: Path,
    robot: RobotDescription,
    meshes: Sequence[LoadedMesh],
    moments: list[Moment],
    rate: float,
) -> None:
    """A trial as an animated GIF; `meshes` are the target's and those of the other objects."""
    frames = [(moment.q, moment.T_world_object) for moment in moments]
    beside = [_others(meshes[1:], moment.T_world_others) for moment in moments]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_gif(path, RobotMeshes(robot, sections=16), Film("", meshes[0], frames, beside), rate)


def _shown(phases: tuple[str, ...]) -> list[int]:
    """Indices of the planned grasp, of the hand closed, and of the end."""
    closed = [i for i, phase in enumerate(phases) if phase in ("close", "grip")]
    chosen = [0, closed[-1] if closed else len(phases) - 1, len(phases) - 1]
    return chosen if len(phases) > 1 else [0]


def _side_by_side(true: Painted, evidence: Evidence, camera: Array, table: Painted) -> Image:
    """Reconstruction and truth in one picture; the reconstruction is half transparent."""
    lower = Stage([table, true]).image(camera, SIZE)
    if not len(evidence.faces):
        return lower
    surfaces = [(evidence.vertices, evidence.faces, BELIEVED_COLOUR)]
    if len(evidence.obstacle_faces):
        surfaces.append((evidence.obstacle_vertices, evidence.obstacle_faces, OTHER_COLOUR))
    seen = [Painted(v.astype(float), f.astype(int), colour) for v, f, colour in surfaces]
    upper = Stage([table, *seen]).image(camera, SIZE)
    mixed = upper.astype(float) * 0.5 + lower.astype(float) * 0.5
    return mixed.astype(np.uint8)
