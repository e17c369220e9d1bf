"""Time to score many grasps of one cloud, with gradients to preshape and palm.

    OMP_NUM_THREADS=2 python benchmarks/bench_grasp_score.py [--checkpoint CKPT ...] [--count 1000]

Wall and CPU milliseconds, best of several runs: on a busy machine the CPU time is the one to trust.
The cloud is one half of a ball, so that the benchmark needs no data. Networks on geometry are set
beside "textbook", the same values by automatic differentiation (`textbook_grasp_score.py`).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from textbook_grasp_score import TextbookScore

from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.models.grasp_score import GeometryGrasps, ObjectGrasps, load_grasp_model
from pointsdf_cli.models.processor import keep_large_allocations

CENTRE, RADIUS = np.array([0.6, 0.0, 0.05]), 0.05


class Ball:
    """The exact distance to the ball, as planning would give a field."""

    def with_gradient(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        offset = points - CENTRE
        length = np.linalg.norm(offset, axis=1)
        return length - RADIUS, offset / np.maximum(length, 1e-9)[:, None]


def seen_from_above() -> tuple[np.ndarray, np.ndarray]:
    """1000 points of the upper half, in the frame of a camera 0.9 m above, and its pose."""
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(1000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[:, 2] = np.abs(normals[:, 2])
    pose = transform(np.diag([1.0, -1.0, -1.0]), CENTRE + [0, 0, 0.9])
    return (CENTRE + RADIUS * normals - pose[:3, 3]) @ pose[:3, :3], pose


def once(grasps: ObjectGrasps | TextbookScore, preshape: torch.Tensor, palm: torch.Tensor) -> None:
    """One value and gradient of log h of all grasps."""
    success = grasps.log_success(preshape, palm)
    torch.autograd.grad(success.sum(), (preshape, palm))


def best_of(runs: int, work: object) -> tuple[float, float]:
    """Least wall and CPU milliseconds."""
    walls, processor = [], []
    for _ in range(runs):
        wall, cpu = time.perf_counter(), time.process_time()
        work()  # type: ignore[operator]
        walls.append(time.perf_counter() - wall)
        processor.append(time.process_time() - cpu)
    return 1e3 * min(walls), 1e3 * min(processor)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--checkpoint", type=Path, nargs="*", default=[None])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--runs", type=int, default=15)
    options = parser.parse_args()
    keep_large_allocations()  # as every command does
    points, pose = seen_from_above()
    print(f"{options.count} grasps, {torch.get_num_threads()} threads; ms wall (CPU)")
    for path in options.checkpoint:
        model = load_grasp_model(path)
        grasps = model.on(points, pose, Ball())
        began = time.perf_counter()
        model.on(points, pose, Ball())
        made = 1e3 * (time.perf_counter() - began)
        preshape, palm = map(
            torch.tensor, grasps.sample("side", options.count, np.random.default_rng(0))
        )
        preshape.requires_grad_(True)
        palm.requires_grad_(True)
        success = best_of(options.runs, lambda g=grasps, p=preshape, t=palm: once(g, p, t))
        few = best_of(
            options.runs,
            lambda g=grasps, p=preshape, t=palm: torch.autograd.grad(
                g.log_success(p[:16], t[:16]).sum(), p
            ),
        )
        prior = best_of(
            options.runs,
            lambda g=grasps, p=preshape, t=palm: torch.autograd.grad(g.log_prior(p, t).sum(), p),
        )
        name = "bundled default" if path is None else path.name
        print(
            f"{name} ({model.network.inputs}): log h {success[0]:.1f} ({success[1]:.1f}), "
            f"of 16 grasps {few[0]:.1f} ({few[1]:.1f}), log g {prior[0]:.1f} ({prior[1]:.1f}), "
            f"reading the object {made:.0f}"
        )
        if isinstance(grasps, GeometryGrasps):
            textbook = TextbookScore(grasps)
            slow = best_of(options.runs, lambda g=textbook, p=preshape, t=palm: once(g, p, t))
            with torch.no_grad():
                apart = grasps.log_success(preshape, palm) - textbook.log_success(preshape, palm)
            print(
                f"  textbook: log h {slow[0]:.1f} ({slow[1]:.1f}), "
                f"{slow[1] / success[1]:.1f} times as long (CPU); "
                f"the values differ by at most {float(apart.abs().max()):.0e}"
            )


if __name__ == "__main__":
    main()
