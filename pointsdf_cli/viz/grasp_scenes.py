"""Grasps and plans as scenes: the robot moves through attempts or along its trajectory."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pointsdf_cli.choices import GRASP_KINDS
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.io.grasps import CAUSES, read_grasps
from pointsdf_cli.io.plans import OK, read_plan
from pointsdf_cli.io.trials import read_trial
from pointsdf_cli.viz.robot_scene import MovingRobot, table_part
from pointsdf_cli.viz.scene import Part, Scene, axes, by_height
from pointsdf_cli.viz.scene_sources import SceneOptions, named_mesh, spread

OBJECT_COLOUR = (0.25, 0.60, 0.35)
OTHER_COLOUR = (0.60, 0.55, 0.50)


def grasps_scene(path: Path, options: SceneOptions) -> Scene:
    """Attempts with one object, one a frame: the cloud, the hand before it closes, the object."""
    grasps, meta = read_grasps(path)
    shown = options.robot_of(path, meta.joint_names)
    chosen = spread(len(grasps), options.most)
    if not len(chosen):
        raise InputError("holds no attempt", where=path)
    robot = MovingRobot(shown)
    thing, palm = len(robot.bodies), len(robot.bodies) + 1
    parts = [*robot.parts, table_part(), axes("palm", "palm", 0.08, palm)]
    for part in named_mesh(path, options):
        parts.append(replace(part, layer="object", colour=OBJECT_COLOUR, body=thing, opacity=0.6))
    captions = []
    for frame, k in enumerate(chosen):
        points = apply_transform(grasps.T_world_camera[k], grasps.cloud[k]).astype(np.float32)
        colours = by_height(points)
        parts.append(Part(f"cloud {k}", "cloud", "points", points, None, colours, frame=frame))
        cause, kind = CAUSES[grasps.cause[k]], GRASP_KINDS[grasps.kind[k]]
        captions.append(f"attempt {int(grasps.attempt[k])}: {kind}, {cause}")
    others = np.stack([grasps.T_world_object, grasps.T_world_palm], axis=1)
    poses = np.concatenate([robot.poses(grasps.q[chosen]), others[chosen]], axis=1)
    counts = ", ".join(f"{cause} {n}" for cause, n in grasps.count().items() if n)
    facts = (("object", meta.mesh_file), ("attempts", str(len(grasps))), ("causes", counts))
    bodies = (*robot.bodies, "object", "palm")
    return Scene(path.name, tuple(parts), bodies, poses, tuple(captions), "attempt", 1.0, facts)


def plan_scene(path: Path, options: SceneOptions) -> Scene:
    """Scene of the motion to the grasp and the completed object; without a motion, the robot at
    home and the reason."""
    plan = read_plan(path)
    shown = options.robot_of(path, plan.joint_names)
    robot = MovingRobot(shown)
    parts = [*robot.parts, axes("world", "axes", 0.1)]
    # Infinite for all links of a plan that was told of no table.
    if not np.isposinf(plan.link_clearance_table).all():
        parts.append(table_part())
    if len(plan.object_faces):
        vertices, faces = plan.object_vertices, plan.object_faces
        parts.append(Part("object", "object", "mesh", vertices, faces, OBJECT_COLOUR, opacity=0.6))
    if plan.status == OK and len(plan.times):
        chosen = spread(len(plan.times), 400)
        q = plan.trajectory[chosen]
        captions = tuple(f"{plan.times[k]:.2f} s" for k in chosen)
        rate = min(len(chosen) / max(float(plan.times[-1]), 0.1), 60.0)
    else:
        q, captions, rate = shown.home[None], ("at home",), 4.0
    poses = robot.poses(q)
    bodies = robot.bodies
    if np.isfinite(plan.T_world_palm).all():
        bodies = (*bodies, "grasp")
        parts.append(axes("grasp", "grasp", 0.1, len(bodies) - 1))
        goal = np.broadcast_to(plan.T_world_palm, (len(poses), 1, 4, 4))
        poses = np.concatenate([poses, goal], axis=1)
    facts = [("status", plan.status)]
    if plan.status == OK:
        duration = f"{plan.times[-1]:.2f}" if len(plan.times) else "none"
        facts.append(("probability of success", f"{plan.success_probability:.3f}"))
        facts.append(("seconds of motion", duration))
    else:
        facts += [("reason", plan.reason), ("", plan.sentence)]
    facts.append(("seeds tried", str(plan.seeds_tried)))
    return Scene(path.name, tuple(parts), bodies, poses, captions, "time", rate, tuple(facts))


def trial_scene(path: Path, options: SceneOptions) -> Scene:
    """One trial: the robot along the planned motion and at the moments of its execution.

    Other objects are shown as the planner saw them. Without a plan, the robot and the object at
    their first poses.
    """
    row, evidence = read_trial(path)
    robot = MovingRobot(options.robot_with(path, evidence.q.shape[1]))
    thing = len(robot.bodies)
    points = np.asarray(evidence.cloud, np.float32)
    # The reconstruction is stored at the object's first pose; it moves with the object.
    T_object_world, faces = invert_transform(evidence.T_world_object[0]), evidence.faces
    believed = apply_transform(T_object_world, evidence.vertices)
    parts = [
        *robot.parts,
        table_part(),
        Part("cloud", "cloud", "points", points, None, by_height(points)),
        Part(row.object, "object", "mesh", believed, faces, OBJECT_COLOUR, thing, opacity=0.6),
    ]
    if len(evidence.obstacle_faces):
        around = evidence.obstacle_vertices, evidence.obstacle_faces
        parts.append(Part("others", "others", "mesh", *around, OTHER_COLOUR, opacity=0.5))
    chosen = spread(len(evidence.times), 200)
    q = np.concatenate([evidence.trajectory[chosen], evidence.q])
    before = np.repeat(evidence.T_world_object[:1], len(chosen), axis=0)
    stands = np.concatenate([before, evidence.T_world_object])[: len(q)]
    captions = [f"planned, {evidence.times[k]:.2f} s" for k in chosen]
    captions += [*evidence.phases] or [row.status] * len(evidence.q)
    facts = (
        ("object", row.object),
        ("method", row.method),
        ("ended", row.cause),
        ("reason", row.reason or "–"),
    )
    bodies = (*robot.bodies, "object")
    poses = np.concatenate([robot.poses(q), stands[:, None]], axis=1)
    return Scene(path.name, tuple(parts), bodies, poses, tuple(captions), "moment", 20.0, facts)
