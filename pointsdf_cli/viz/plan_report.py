"""Report on one plan: the decision, its distances, and the rejected seeds."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from pointsdf_cli.io.plans import OK, SLACKS, Plan
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.viz import html
from pointsdf_cli.viz.plan_picture import BELIEVED_COLOUR
from pointsdf_cli.viz.robot_picture import robot_poses_picture
from pointsdf_cli.viz.shading import Painted


def plan_report(plan: Plan, robot: RobotDescription, title: str) -> str:
    """HTML page of a plan, with the robot at the start, half-way and at the grasp."""
    parts = [html.table(("", ""), _facts(plan))]
    completed = Painted(plan.object_vertices, plan.object_faces, BELIEVED_COLOUR)
    things = [completed] if len(plan.object_faces) else []
    if plan.status == OK and len(plan.times):
        moments = plan.trajectory[np.linspace(0, len(plan.times) - 1, 3).round().astype(int)]
        buffer = io.BytesIO()
        picture = Image.fromarray(robot_poses_picture(robot, list(moments), 380, things))
        picture.save(buffer, format="png")
        said = "the robot at the start, half-way and at the grasp"
        parts += [html.heading("Start, half-way, grasp"), html.png(buffer.getvalue(), said)]
    timings = sorted((name, float(seconds)) for name, seconds in plan.timings.items())
    parts += [html.heading("Time by stage"), html.table(("stage", "s"), timings)]
    if plan.status == OK:
        clearances = zip(
            plan.link_names, plan.link_clearance_object, plan.link_clearance_table, strict=True
        )
        distances = [(link, _mm(thing), _mm(table)) for link, thing, table in clearances]
        joints = [(name, float(q)) for name, q in zip(plan.joint_names, plan.q, strict=True)]
        parts += [
            html.heading("Distances at the grasp"),
            html.table(("link", "to the object [mm]", "to the table [mm]"), distances),
            html.heading("Configuration"),
            html.table(("joint", "at the grasp [rad or m]"), joints),
        ]
    if plan.rejected.reasons:
        rejected = plan.rejected
        chances, objectives = rejected.success_probability.tolist(), rejected.objective.tolist()
        seeds = zip(rejected.reasons, chances, objectives, rejected.slack, strict=True)
        slacks = [f"slack to {name} [mm]" for name in SLACKS]
        rows = [
            (reason, chance, objective, *map(_mm, slack))
            for reason, chance, objective, slack in seeds
        ]
        parts += [
            html.heading("Rejected"),
            html.note("Slack is the distance minus the required clearance: below 0 is too near."),
            html.table(("reason", "success", "objective", *slacks), rows),
        ]
    return html.page(title, parts)


def _facts(plan: Plan) -> list[tuple[str, object]]:
    facts: list[tuple[str, object]] = [("status", plan.status)]
    if plan.status == OK:
        facts += [
            ("kind", plan.kind),
            ("probability of success", float(plan.success_probability)),
            ("objective", float(plan.objective)),
            ("duration of the motion [s]", float(plan.times[-1]) if len(plan.times) else "none"),
            ("accepted grasps", len(plan.accepted.q)),
        ]
        if plan.sentence:
            facts.append(("warning", plan.sentence))
    else:
        facts += [("reason", plan.reason), ("", plan.sentence)]
    return [*facts, ("seeds tried", plan.seeds_tried), ("seeds rejected", len(plan.rejected.q))]


def _mm(metres: float) -> object:
    return round(1e3 * float(metres), 2) if np.isfinite(metres) else "far"
