"""Twelve scenes, planned by both methods, each seen from behind: what the camera did not see.

    python benchmarks/bench_plan.py --out .work/plans
    python benchmarks/plan_gallery.py .work/plans docs/images/plans.png

Reads the plans and makes the scenes again by their seed. The object drawn is the true one.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image
from plan_scenes import TableScene, table_scenes

from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.plans import OK, Plan, read_plan
from pointsdf_cli.planning.answer import METHODS
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.plan_picture import PlanScene, close_up
from pointsdf_cli.viz.robot_picture import RobotMeshes

REPOSITORY = Path(__file__).resolve().parents[1]
COUNT, COLUMNS, CELL = 12, 4, (300, 260)
COLOURS = 200


def caption(plan: Plan, depth: float) -> str:
    if plan.status != OK:
        return f"no plan: {plan.reason}"
    words = f"{plan.kind}, h = {plan.success_probability:.2f}"
    return words + (f", {depth * 1000:.0f} mm in it" if depth > 0.002 else "")


def cell(robot: RobotMeshes, plan: Plan, scene: TableScene, home: np.ndarray) -> np.ndarray:
    T = scene.T_world_camera
    drawn = PlanScene(
        apply_transform(T, scene.points), T[:3, 3], None, true=(scene.vertices, scene.faces)
    )
    return close_up(robot, plan.q if plan.status == OK else home, drawn, True, CELL)


def main(folder: Path, out: Path) -> None:
    meshes = Path(os.environ.get("RGRASP_MESHES", REPOSITORY.parent / "shared" / "meshes"))
    robot = load_robot()
    painted = RobotMeshes(robot, sections=24)
    rows = {m: json.loads((folder / f"rows_{m}.json").read_text()) for m in METHODS}
    scenes = table_scenes(meshes / "test", robot, COUNT)
    figure, axes = plt.subplots(
        COUNT * len(METHODS) // COLUMNS, COLUMNS, figsize=(3.0 * COLUMNS, 17.4), squeeze=False
    )
    for k, scene in enumerate(scenes):
        for m, method in enumerate(METHODS):
            place = k * len(METHODS) + m
            axis = axes[place // COLUMNS][place % COLUMNS]
            plan = read_plan(folder / f"{method}_sqp_{k:02d}.h5")
            axis.imshow(cell(painted, plan, scene, robot.home))
            axis.axis("off")
            words = caption(plan, rows[method][k].get("depth", 0.0))
            title = f"{scene.name[:26]}, {scene.camera} camera\n{method}: {words}"
            axis.set_title(title, fontsize=7, loc="left")
    figure.subplots_adjust(0.005, 0.0, 0.995, 0.98, wspace=0.02, hspace=0.14)
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=100)
    # A palette keeps the file small; the pictures have few colours.
    Image.open(out).convert("RGB").quantize(COLOURS).save(out, optimize=True)
    print(f"{out}: {out.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
