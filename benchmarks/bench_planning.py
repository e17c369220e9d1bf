"""Planning times, and SQP against SLSQP on the same seeds.

    OMP_NUM_THREADS=1 python benchmarks/bench_planning.py [--scenes 12] [--compare 4] [--network]

Objects are boxes, cylinders and balls at random places on the table. Their signed distances are
exact, or with --network the shipped network's, from one rendered view. The score of grasps is a
formula (palm in front of the object, facing it), so this measures seeds, solver, checks and motion,
and the reconstruction, but not the success network. Stages are wall seconds; the comparison is in
CPU seconds of one thread, which do not depend on what else runs.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from skimage.measure import marching_cubes
from torch import Tensor

from pointsdf_cli.camera.pinhole import from_field_of_view
from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.planning.acceptance import judge
from pointsdf_cli.planning.environment import Environment
from pointsdf_cli.planning.plan_artifact import plan_of
from pointsdf_cli.planning.planner import Planner, PlannerConfig
from pointsdf_cli.planning.seeds import draw_seeds
from pointsdf_cli.planning.target import Target, reconstructed_object
from pointsdf_cli.robot.description import load_robot

REST = np.array([0.0] * 6 + [1.3, 0.5])


@dataclass(frozen=True)
class Solid:
    """An upright rounded box: box, cylinder and ball are special cases; its field is exact."""

    half: Array
    radius: float
    centre: Array

    def __call__(self, points: Array) -> Array:
        excess = np.abs(points - self.centre) - self.half
        outside = np.sqrt((np.maximum(excess, 0) ** 2).sum(axis=1))
        return outside + np.minimum(excess.max(axis=1), 0) - self.radius

    def with_gradient(self, points: Array) -> tuple[Array, Array]:
        offset = points - self.centre
        excess = np.abs(offset) - self.half
        beyond = np.maximum(excess, 0)
        length = np.sqrt((beyond**2).sum(axis=1))
        inside = np.eye(3)[excess.argmax(axis=1)]
        unit = np.where(length[:, None] > 0, beyond / np.maximum(length, 1e-12)[:, None], inside)
        return self(points), unit * np.sign(offset)

    @property
    def reach(self) -> Array:
        """Half extents [3]."""
        return self.half + self.radius


class FacingScore:
    """log h falls with the palm's distance to a stand-off from the object and with its turn."""

    def __init__(self, solid: Solid) -> None:
        self._centre = torch.tensor(solid.centre)
        self._standoff = float(solid.reach[:2].mean()) + 0.01

    def log_success(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        way = self._centre - T_world_palm[:, :3, 3]
        length = way.square().sum(dim=1).sqrt()
        facing = (T_world_palm[:, :3, 0] * way).sum(dim=1) / length
        return -((length - self._standoff) / 0.05).square() - 2 * (1 - facing)

    def log_prior(self, preshape: Tensor, T_world_palm: Tensor) -> Tensor:
        level = T_world_palm[:, 2, 2].square()
        return 1.0 - (preshape - torch.tensor(REST)).square().sum(dim=1) - level


class FacingPrior:
    """Side grasps all around the object, as a prior that knows nothing of the arm draws them."""

    def __init__(self, solid: Solid) -> None:
        self._solid = solid

    def sample(self, kind: str, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
        angle = rng.uniform(-np.pi, np.pi, count)
        x = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        y = np.tile([0.0, 0.0, 1.0], (count, 1))
        palm = np.tile(np.eye(4), (count, 1, 1))
        palm[:, :3, :3] = np.stack([x, y, np.cross(x, y)], axis=2)
        away = self._solid.reach[:2].mean() + 0.07 + rng.normal(0, 0.02, count)
        palm[:, :3, 3] = self._solid.centre - away[:, None] * x
        palm[:, :3, 3] += rng.normal(0, 0.01, (count, 3))
        return REST + rng.normal(0, 0.05, (count, len(REST))), palm


def scene(rng: np.random.Generator) -> Target:
    """One object standing on the table in front of the robot."""
    shape = rng.integers(3)
    if shape == 0:
        half, radius = np.array([*rng.uniform(0.015, 0.035, 2), rng.uniform(0.05, 0.12)]), 0.003
    elif shape == 1:
        half, radius = np.array([0.0, 0.0, rng.uniform(0.04, 0.1)]), rng.uniform(0.02, 0.04)
    else:
        half, radius = np.zeros(3), rng.uniform(0.03, 0.045)
    angle, away = rng.uniform(-0.9, 0.9), rng.uniform(0.5, 0.7)
    height = half[2] + radius
    solid = Solid(
        half, float(radius), np.array([away * np.cos(angle), away * np.sin(angle), height])
    )
    low, high = solid.centre - solid.reach - 0.03, solid.centre + solid.reach + 0.03
    return Target(solid, low, high, FacingScore(solid), FacingPrior(solid))


def seen_by_network(target: Target, model: ShapeModel, seed: int) -> Target:
    """The same object as the network completes it from one view of a camera to the side."""
    solid = target.field
    assert isinstance(solid, Solid)
    mesh = mesh_of(solid)
    eye = solid.centre + [-0.2, 0.8, 0.45]
    z = (solid.centre - eye) / np.linalg.norm(solid.centre - eye)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3] = np.column_stack([x, np.cross(z, x), z])
    T_world_camera[:3, 3] = eye
    camera = from_field_of_view(640, 480, 0.820305)
    caster = MeshCaster(mesh.vertices, mesh.faces, camera)
    patch = caster.cast(np.linalg.inv(T_world_camera))
    points = camera.back_project(patch.u, patch.v, patch.depth)
    world = points @ T_world_camera[:3, :3].T + eye
    shape = Reconstruction.from_cloud(model, world, eye, T_world_camera[:3, :3], seed=seed)
    return Target.of(reconstructed_object([shape]), target.score, target.prior)


def mesh_of(solid: Solid) -> trimesh.Trimesh:
    """The zero level of the exact field."""
    low, high = solid.centre - solid.reach - 0.01, solid.centre + solid.reach + 0.01
    count = np.ceil((high - low) / 0.004).astype(int) + 1
    axes = [np.linspace(lo, hi, n) for lo, hi, n in zip(low, high, count, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    values = solid(nodes).reshape(count)
    step = tuple(float(a[1] - a[0]) for a in axes)
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=step)
    return trimesh.Trimesh(vertices + low, faces)


def quantiles(seconds: list[float]) -> str:
    return f"{np.median(seconds):.2f} / {np.quantile(seconds, 0.95):.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--compare", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--network", action="store_true")
    options = parser.parse_args()
    torch.set_num_threads(1)
    planner = Planner(load_robot(), PlannerConfig())
    rng = np.random.default_rng(options.seed)
    scenes = [scene(rng) for _ in range(options.scenes)]
    if options.network:
        began = time.process_time()
        model = load_model()
        scenes = [seen_by_network(target, model, k) for k, target in enumerate(scenes)]
        print(f"encoding and box: {(time.process_time() - began) / len(scenes):.2f} s a scene")
    planner.search(scenes[0])  # compile the step's program, load libraries

    stages: dict[str, list[float]] = {"CPU of all": []}
    reasons: list[str] = []
    for k, target in enumerate(scenes):
        began = time.process_time()
        plan = plan_of(planner.search(target, seed=k))
        stages["CPU of all"].append(time.process_time() - began)
        reasons.append(plan.reason or "ok")
        for stage, seconds in plan.timings.items():
            stages.setdefault(stage, []).append(seconds)
    print(f"{options.scenes} scenes, one thread; seconds, median / 95th percentile")
    for stage, seconds in stages.items():
        print(f"  {stage:14} {quantiles(seconds)}")
    print("  outcomes       " + ", ".join(f"{r} {reasons.count(r)}" for r in sorted(set(reasons))))

    compare(planner, scenes[: options.compare])


def compare(planner: Planner, scenes: list[Target]) -> None:
    """Both solvers from the same seeds; SLSQP on the exact field, one seed after the other."""
    paper = Planner(planner.robot, PlannerConfig(solver="slsqp"))
    rows: dict[str, list[tuple[float, int, float]]] = {"sqp": [], "slsqp": []}
    for k, target in enumerate(scenes):
        problems = planner.problems(target, Environment())
        seeds = draw_seeds(
            problems.quick, target.prior, planner.inverse, "side", np.random.default_rng(k)
        )
        if not len(seeds.x):
            continue
        for name in rows:
            began = time.process_time()
            if name == "sqp":
                x = planner.solver.solve(problems.quick, seeds.x).x
                x = planner.solver.solve(problems.polish, x).x
            else:
                x = paper.solver.solve(paper.problems(target, Environment()).quick, seeds.x).x
            took = time.process_time() - began
            judged = judge(problems.exact, x)
            accepted = [c for c in judged if not c.reason]
            best = min((c.objective for c in accepted), default=float("inf"))
            rows[name].append((took, len(accepted), best))
    if not rows["sqp"]:
        return
    print(f"{len(rows['sqp'])} scenes, the same seeds: seconds, accepted solutions, best objective")
    for name, values in rows.items():
        seconds, counts, bests = (np.array(column) for column in zip(*values, strict=True))
        print(f"  {name:6} {seconds.mean():.2f} s, {counts.sum()}, {np.median(bests):.3f}")
    ratio = sum(r[0] for r in rows["slsqp"]) / sum(r[0] for r in rows["sqp"])
    print(f"  sqp is {ratio:.1f} times faster")


if __name__ == "__main__":
    main()
