"""Training throughput: bfloat16, float32, and PointConv the textbook way, in one run.

    python benchmarks/bench_train_sdf.py [--preset small|paper] [--device cpu|cuda] [--seconds 10]

Each row is whole training steps (batch from a pack in memory, forward, backward, AdamW) of the same
batch and the same number of queries, the methods taking turns so that a busy machine treats all
alike; the best of the turns counts. On a CPU the clock is processor time over threads.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable

import numpy as np
import torch
from textbook_pointconv import TextbookPointSDF

from pointsdf_cli.models.pointsdf import PointSDF
from pointsdf_cli.models.pointsdf_ray import PointSDFRay
from pointsdf_cli.models.processor import keep_large_allocations
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.training.precision import autocast_dtype
from pointsdf_cli.training.presets import preset
from pointsdf_cli.training.sdf_config import SdfLoss
from pointsdf_cli.training.sdf_data import augment, predict, read_batch
from pointsdf_cli.training.sdf_loss import sdf_loss
from pointsdf_cli.training.sdf_pack import Pack, pack_views

PAPER_CLOUDS = 8_500_000


def sphere_pack(views: int = 256) -> Pack:
    """Views of one sphere; throughput does not depend on the shape."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(views, 1000, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    directions[..., 2] = -np.abs(directions[..., 2])
    T = np.tile(np.eye(4), (views, 1, 1))
    T[:, 2, 3] = 1.5
    arrays = pack_views((0.05 * directions + [0.0, 0.0, 1.5]).astype(np.float32), T)
    points = rng.uniform(-0.08, 0.08, (20_000, 3)).astype(np.float32)
    return Pack(
        **arrays,
        object_of_view=np.zeros(views, np.int32),
        points=points,
        sdf=(np.linalg.norm(points, axis=1) - 0.05).astype(np.float32),
        label_start=np.array([0, len(points)]),
        names=("sphere",),
        meshes=("",),
    )


def stepper(
    model: ShapeModel, precision: str, pack: Pack, batch: int, queries: int, device: torch.device
) -> Callable[[int], None]:
    """A function that takes one training step."""
    model.to(device).train()
    optimiser = torch.optim.AdamW(model.parameters(), lr=1e-4, fused=True)
    low_precision = autocast_dtype(precision, device)
    loss = SdfLoss()

    def step(number: int) -> None:
        rng = np.random.default_rng(number)
        views = rng.integers(len(pack.scale), size=batch)
        data = augment(read_batch(pack, views, queries, rng), rng).to(device)
        with torch.autocast(device.type, low_precision, enabled=low_precision is not None):
            predicted = predict(model, data)
        value = sdf_loss(loss, predicted, data.sdf)
        optimiser.zero_grad(set_to_none=True)
        value.backward()
        optimiser.step()
        if device.type == "cuda":
            torch.cuda.synchronize()

    return step


def main() -> None:
    """Measure and print a table; the same as JSON with --json."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--preset", choices=("small", "paper"), default="small")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--batch-size", type=int, default=16)
    parser.add_argument("--queries", type=int, default=256)
    parser.add_argument("--seconds", type=float, default=10.0, help="for each row")
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    torch.set_num_threads(chosen.threads)
    torch.manual_seed(0)
    keep_large_allocations()
    device, arguments = torch.device(chosen.device), preset("pointsdf", chosen.preset)[0]

    def timed(model: ShapeModel, precision: str) -> Callable[[int], None]:
        return stepper(model, precision, pack, chosen.batch_size, chosen.queries, device)

    ray, _ = preset("pointsdf-ray", "small")
    pack = sphere_pack()
    # Processor time, so that other programs on the machine weigh little; a GPU is waited for.
    clock = time.perf_counter if device.type == "cuda" else time.process_time
    rows = {
        "PointSDF, bfloat16": timed(PointSDF(**arguments), "bfloat16"),
        "PointSDF, float32": timed(PointSDF(**arguments), "float32"),
        "PointSDF-ray, bfloat16": timed(PointSDFRay(**ray), "bfloat16"),
        "PointSDF-ray, float32": timed(PointSDFRay(**ray), "float32"),
    }
    if device.type == "cpu":
        rows["PointSDF, textbook, float32"] = timed(TextbookPointSDF(**arguments), "float32")
    fastest = dict.fromkeys(rows, float("inf"))
    used = dict.fromkeys(rows, 0.0)
    for step in rows.values():
        step(0)
    number = 1
    while min(used.values()) < chosen.seconds:
        for name, step in rows.items():
            if used[name] < chosen.seconds:
                started = clock()
                step(number)
                elapsed = clock() - started
                used[name] += elapsed
                fastest[name] = min(fastest[name], elapsed)
        number += 1
    speed = {name: chosen.batch_size / seconds for name, seconds in fastest.items()}
    if chosen.json:
        json.dump(speed, sys.stdout)
        return
    slowest = min(speed.values())
    for name, clouds in sorted(speed.items(), key=lambda item: -item[1]):
        hours = PAPER_CLOUDS / clouds / 3600
        print(
            f"{name:28} {clouds:8.1f} clouds/s {clouds / slowest:6.1f} × "
            f"{hours:8.1f} h for 8.5 M clouds"
        )


if __name__ == "__main__":
    main()
