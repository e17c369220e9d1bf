"""Planning on real shapes: time, success rate, and truth of the answers.

    OMP_NUM_THREADS=1 python benchmarks/bench_plan.py [--scenes 60] [--slsqp 4] [--out DIR]

Objects of ../shared/meshes/test (RGRASP_MESHES) stand on the table and are seen by a high and a low
camera in turn; the cloud holds table and robot, and is segmented as a real one would be. Both
methods plan with the bundled weights. Judged against the true mesh: how deep hand or arm stand in
it before the hand closes. Also: depth in the table, joint limits, and the whole trajectory at steps
of 1 mm against what the planner knew. `slsqp` plans a few scenes again, the paper's way.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from plan_scenes import TableScene, table_scenes

from pointsdf_cli.camera.view import View
from pointsdf_cli.geometry.signed_distance import SignedDistance
from pointsdf_cli.io.plans import OK, Plan, write_plan
from pointsdf_cli.planning.answer import Answer
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.fields import RefinedField
from pointsdf_cli.planning.grasp_planner import GraspPlanner, PlanOptions
from pointsdf_cli.planning.option_checks import METHODS
from pointsdf_cli.planning.path_check import PathChecker
from pointsdf_cli.planning.planner import PlannerConfig
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics
from pointsdf_cli.robot.surface import robot_surface

REPOSITORY = Path(__file__).resolve().parents[1]
MESHES = REPOSITORY.parent / "shared" / "meshes"
TOUCH = 0.002
"""Deeper than this [m] in the true object counts as standing in it."""


class Judge:
    """Measures a plan against the truth, by surface samples 4 mm apart.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._kinematics = Kinematics(robot)
        links = robot_surface(robot, 0.004).items()
        self._links = [(name, p) for name, p in links if name not in robot.links_on_table]

    def depths(self, plan: Plan, scene: TableScene) -> tuple[float, float]:
        """Penetration of the robot into the true object and into the table [m], 0 if none."""
        points = np.concatenate(self._kinematics.points(plan.q, self._links))
        inside = SignedDistance(scene.vertices, scene.faces, threads=1)(points)
        return max(0.0, -float(inside.min())), max(0.0, -float(points[:, 2].min()))


def least_slack(planner: GraspPlanner, answer: Answer) -> float:
    """The least distance less clearance [m] on the trajectory, at steps of 1 mm, by a field that is
    exact wherever anything is near; no proof is used, every step is looked at."""
    target, clearances = answer.target, planner.options.planner.clearances
    assert target is not None
    assert target.kept is not None
    field = RefinedField(target.kept, target.field, 0.004)
    checker = PathChecker(planner.planner.geometry, field, Environment(), clearances)
    path, least = answer.plan.trajectory, np.inf
    for a, b in pairwise(path):
        steps = max(1, int(np.ceil(float(checker.motion(a, b).max()) / 0.001)))
        share = np.linspace(0, 1, steps, endpoint=False)[:, None]
        least = min(least, float(checker.slack((1 - share) * a + share * b).min()))
    return least


def run(
    planner: GraspPlanner,
    scenes: list[TableScene],
    out: Path | None = None,
    walk: int = 0,
    chosen: list[int] | None = None,
) -> list[dict[str, object]]:
    """A row for each scene, or for those of the chosen indices."""
    judge, rows = Judge(planner.robot), []
    first = scenes[0]
    if planner.options.planner.solver == "sqp":  # compile the step's program, load libraries
        planner.plan([View(first.points, first.T_world_camera)])
    for k in range(len(scenes)) if chosen is None else chosen:
        scene = scenes[k]
        wall, cpu = time.perf_counter(), time.process_time()
        answer = planner.plan([View(scene.points, scene.T_world_camera)], seed=k)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        plan = answer.plan
        row: dict[str, object] = {
            "scene": f"{k:02d} {scene.name} {scene.camera}",
            "outcome": plan.reason or "ok",
            "kind": plan.kind,
            "h": plan.success_probability,
            "cpu": cpu,
            "wall": wall,
            "seeds": plan.seeds_tried,
            "timings": dict(plan.timings),
        }
        if plan.status == OK:
            row["depth"], row["table"] = judge.depths(plan, scene)
            low, high = planner.robot.hard_lower, planner.robot.hard_upper
            over = np.maximum(low - plan.trajectory, plan.trajectory - high)
            row["limits"] = max(0.0, float(over.max()))  # [rad]
            if k < walk:
                row["slack"] = least_slack(planner, answer)
        rows.append(row)
        words = " ".join(f"{v:.4f}" if isinstance(v, float) else str(v) for v in row.values())
        print("  " + words, flush=True)
        if out is not None:
            name = f"{planner.options.method}_{planner.options.planner.solver}_{k:02d}.h5"
            write_plan(out / name, plan, seed=k)
    return rows


def summary(rows: list[dict[str, object]]) -> None:
    """The measures of a run, as lines."""

    def of(name: str) -> np.ndarray:
        return np.array([row[name] for row in rows if name in row], dtype=float)

    planned = of("depth")
    # A scene without an object has no stages.
    looked = [float(row["timings"].get("configuration", 0.0)) for row in rows]  # type: ignore[attr-defined]
    share = np.array(looked) / of("wall")
    print(f"  plans            {len(planned)} of {len(rows)}")
    outcomes = [str(row["outcome"]) for row in rows]
    print(
        "  outcomes         " + ", ".join(f"{o} {outcomes.count(o)}" for o in sorted(set(outcomes)))
    )
    for name, seconds in (
        ("CPU, configuration", of("cpu") * share),
        ("CPU, motion", of("cpu") * (1 - share)),
        ("wall, whole", of("wall")),
    ):
        print(
            f"  {name:18} median {np.median(seconds):.2f} s, 95% {np.quantile(seconds, 0.95):.2f} s"
        )
    if len(planned):
        print(
            f"  in the object    over 2 mm {int((planned > TOUCH).sum())} of {len(planned)}, "
            f"median {np.median(planned) * 1000:.1f} mm, worst {planned.max() * 1000:.1f} mm"
        )
        print(f"  in the table     {int((of('table') > 0).sum())}")
        print(f"  beyond limits    {int((of('limits') > 1e-9).sum())}")
        slack = of("slack")
        if len(slack):
            print(f"  trajectories     least slack {slack.min() * 1000:.2f} mm in {len(slack)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=60)
    parser.add_argument("--slsqp", type=int, default=4)
    parser.add_argument("--walk", type=int, default=12, help="trajectories walked at 1 mm")
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
    folder = Path(os.environ.get("RGRASP_MESHES", MESHES)) / "test"
    if not folder.is_dir():
        print(f"left out: no meshes in {folder}; RGRASP_MESHES names a folder with a folder test")
        return
    results = {}
    for method in options.methods.split(","):
        planner = GraspPlanner(PlanOptions(method=method))
        scenes = table_scenes(folder, planner.robot, options.scenes, options.seed)
        print(f"{method}, {len(scenes)} scenes, one thread")
        results[method] = run(planner, scenes, options.out, options.walk)
        summary(results[method])
        if options.out:
            (options.out / f"rows_{method}.json").write_text(json.dumps(results[method], indent=1))
    if options.slsqp and "reconstruction" in results:
        paper = GraspPlanner(PlanOptions(planner=PlannerConfig(solver="slsqp")))
        # Scenes that took one round of seeds, so that both solve as much.
        rows = results["reconstruction"]
        chosen = [k for k, row in enumerate(rows) if row["seeds"] == 8][: options.slsqp]
        if not chosen:
            raise SystemExit("no scene took one round of seeds: give more --scenes")
        scenes = table_scenes(folder, paper.robot, options.scenes, options.seed)
        print(f"reconstruction by slsqp, {len(chosen)} scenes")
        ours, rows = [rows[k] for k in chosen], run(paper, scenes, chosen=chosen)
        summary(rows)
        took = [sum(float(str(row["cpu"])) for row in each) for each in (rows, ours)]
        print(f"  slsqp takes {took[0] / took[1]:.1f} times as long (CPU, cloud to motion)")
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory {memory:.2f} GiB")


if __name__ == "__main__":
    main()
