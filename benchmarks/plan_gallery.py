"""Twelve scenes planned by both methods, each seen from behind: what the camera did not see.

The three in which a hand stands deepest in the true object, by either method, then the first in
which both methods found a plan.

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
from pointsdf_cli.planning.option_checks import METHODS
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.viz.plan_picture import PlanScene, close_up
from pointsdf_cli.viz.robot_picture import RobotMeshes

REPOSITORY = Path(__file__).resolve().parents[1]
COUNT, DEEPEST, COLUMNS, CELL = 12, 3, 4, (380, 300)
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


def picked(rows: dict[str, list[dict]]) -> list[int]:
    """Indices of the scenes to show."""
    planned = [
        k
        for k, pair in enumerate(zip(*rows.values(), strict=True))
        if all("depth" in r for r in pair)
    ]
    planned.sort(key=lambda k: -max(rows[m][k]["depth"] for m in rows))
    return planned[:DEEPEST] + sorted(planned[DEEPEST:])[: COUNT - DEEPEST]


def main(folder: Path, out: Path) -> None:
    meshes = Path(os.environ.get("RGRASP_MESHES", REPOSITORY.parent / "shared" / "meshes"))
    robot = load_robot()
    painted = RobotMeshes(robot, sections=24)
    rows = {m: json.loads((folder / f"rows_{m}.json").read_text()) for m in METHODS}
    scenes = table_scenes(meshes / "test", robot, len(rows[METHODS[0]]))
    figure, axes = plt.subplots(
        COUNT * len(METHODS) // COLUMNS, COLUMNS, figsize=(3.4 * COLUMNS, 18.2), squeeze=False
    )
    for i, k in enumerate(picked(rows)):
        scene = scenes[k]
        for m, method in enumerate(METHODS):
            place = i * len(METHODS) + m
            axis = axes[place // COLUMNS][place % COLUMNS]
            plan = read_plan(folder / f"{method}_sqp_{k:02d}.h5")
            axis.imshow(cell(painted, plan, scene, robot.home))
            axis.axis("off")
            words = caption(plan, rows[method][k].get("depth", 0.0))
            title = f"{scene.name[:26]}, {scene.camera} camera\n{method}: {words}"
            axis.set_title(title, fontsize=8, loc="left")
    figure.subplots_adjust(0.005, 0.0, 0.995, 0.98, wspace=0.02, hspace=0.12)
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=100)
    # A palette keeps the file small; the pictures have few colours.
    Image.open(out).convert("RGB").quantize(COLOURS).save(out, optimize=True)
    print(f"{out}: {out.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
