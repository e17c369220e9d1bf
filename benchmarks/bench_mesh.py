"""`mesh`: seconds, queries, memory; against the dense grid and against a literal MISE.

    python benchmarks/bench_mesh.py [--cloud FILE] [--checkpoint DIR] [--threads 2]
        [--precision auto] [--resolutions 128 512] [--exact] [--views FOLDER] [--literal 64]
        [--dense 128] [--json FILE]

Each resolution is timed in a process of its own, so that its peak memory is its own. The literal
MISE is the algorithm as it is told: a dictionary of points, each asked by itself. It is run whole,
at a resolution that ends in a minute or two, and its time a point is then also applied to the
points that it would need at the other resolutions. CPU seconds stand beside wall seconds, because
a busy machine slows the wall clock only. `--exact` asks the network everywhere; `--views` times the
first view of each object in a folder of `rgrasp render` too, at the first resolution. About
five minutes on two cores; `--literal 0` and
`--dense 0` leave the slow parts out.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial import cKDTree

from pointsdf_cli.geometry.isosurface import Isosurface, IsosurfaceConfig, extract_isosurface
from pointsdf_cli.geometry.mise import SearchRules
from pointsdf_cli.io.clouds import read_cloud
from pointsdf_cli.io.views import read_views
from pointsdf_cli.models.meshing import mesh_reconstruction, network_field
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model, use_threads
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.training.precision import autocast_dtype

REPEATS = 3


def mug_view() -> np.ndarray:
    """A view of a mug of 8 × 9 cm at 0.8 m, made here: no file is needed."""
    import trimesh

    from pointsdf_cli.camera.pinhole import CAMERAS
    from pointsdf_cli.camera.raycast import MeshCaster
    from pointsdf_cli.camera.views import sample_cloud
    from pointsdf_cli.geometry.frames import transform

    profile = [(0, 0), (0.04, 0), (0.04, 0.09), (0.036, 0.09), (0.036, 0.005), (0, 0.005)]
    mug = trimesh.creation.revolve(np.array(profile), sections=64)
    tilt = trimesh.transformations.rotation_matrix(-2.3, [1, 0, 0])[:3, :3]
    caster = MeshCaster(mug.vertices, mug.faces, CAMERAS["reference"])
    patch = caster.cast(transform(tilt, [0, 0, 0.8]))
    return sample_cloud(patch, CAMERAS["reference"], np.random.default_rng(0))


def read(options: argparse.Namespace) -> tuple[ShapeModel, np.ndarray]:
    """The network and the cloud."""
    use_threads(options.threads)
    points = read_cloud(options.cloud).points if options.cloud else mug_view()
    return load_model(options.checkpoint), points


def reconstruct(options: argparse.Namespace) -> Reconstruction:
    return Reconstruction.from_cloud(*read(options), np.zeros(3), vessels=False)


def time_mesh(job: tuple[argparse.Namespace, int]) -> dict[str, float]:
    """Best of a few runs at one resolution, and the peak memory of the process."""
    options, resolution = job
    low_precision = autocast_dtype(options.precision, torch.device("cpu"))
    model, points = read(options)
    reconstruction = Reconstruction.from_cloud(model, points, np.zeros(3), vessels=False)
    mesh_reconstruction(reconstruction, 32)  # warm
    runs = []
    for _ in range(REPEATS):
        wall, cpu = time.perf_counter(), time.process_time()
        reconstruction = Reconstruction.from_cloud(model, points, np.zeros(3), vessels=False)
        encoded = time.perf_counter()
        reconstruction = reconstruction.in_precision(low_precision)
        mesh = mesh_reconstruction(reconstruction, resolution, exact=options.exact)
        done = time.perf_counter()
        runs.append((done - wall, encoded - wall, time.process_time() - cpu))
    seconds, encoding, cpu = min(runs)
    return {
        "resolution": resolution,
        "seconds": seconds,
        "of_which_encoding": encoding,
        "cpu_seconds": cpu,
        "queries": mesh.queries,
        "share_of_dense": mesh.queries / (resolution + 1) ** 3,
        "vertices": len(mesh.vertices),
        "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }


def time_views(options: argparse.Namespace) -> list[tuple[float, int]]:
    """Seconds and queries of the first view of every object in `--views`, at one resolution."""
    use_threads(options.threads)
    model = load_model(options.checkpoint)
    low_precision = autocast_dtype(options.precision, torch.device("cpu"))
    resolution = options.resolutions[0]
    found = []
    for path in sorted(options.views.rglob("*.h5")):
        points = read_views(path).cloud[0].astype(np.float64)
        runs = []
        for _ in range(2):  # the first one warms what depends on the sizes
            started = time.perf_counter()
            shape = Reconstruction.from_cloud(model, points, np.zeros(3), vessels=False)
            shape = shape.in_precision(low_precision)
            mesh = mesh_reconstruction(shape, resolution, exact=options.exact)
            runs.append(time.perf_counter() - started)
        found.append((min(runs), mesh.queries))
    return found


def literal_mise(
    ask: Callable[[tuple[float, float, float]], float], resolution: int, coarse: int, half: float
) -> tuple[int, int]:
    """MISE as told, point by point: the number of points asked and of cells crossed."""
    values: dict[tuple[int, int, int], float] = {}
    step = 2 * half / resolution

    def crossed(cell: tuple[int, ...], size: int) -> bool:
        inside = []
        for offset in product((0, size), repeat=3):
            corner = (cell[0] + offset[0], cell[1] + offset[1], cell[2] + offset[2])
            if corner not in values:
                x, y, z = (index * step - half for index in corner)
                values[corner] = ask((x, y, z))
            inside.append(values[corner] < 0)
        return any(inside) and not all(inside)

    size = resolution // coarse
    cells = [c for c in product(range(0, resolution, size), repeat=3) if crossed(c, size)]
    while size > 1:
        size //= 2
        children = (
            (c[0] + o[0], c[1] + o[1], c[2] + o[2])
            for c in cells
            for o in product((0, size), repeat=3)
        )
        cells = [c for c in children if crossed(c, size)]
    return len(values), len(cells)


def time_literal(options: argparse.Namespace) -> dict[str, float]:
    """The literal MISE, run whole at one resolution."""
    reconstruction = reconstruct(options)
    field = network_field(reconstruction)

    def ask(point: tuple[float, float, float]) -> float:
        return float(field(np.array([point], np.float32))[0])

    ask((0, 0, 0))
    started = time.perf_counter()
    points, cells = literal_mise(ask, options.literal, 32, reconstruction.model.box)
    seconds = time.perf_counter() - started
    return {
        "resolution": options.literal,
        "seconds": seconds,
        "points": points,
        "cells": cells,
        "ms_a_point": 1e3 * seconds / points,
    }


def against_dense(options: argparse.Namespace) -> dict[str, Any]:
    """Distance of the surface from the dense grid's, in network units, both ways."""
    field = network_field(reconstruct(options))
    config = IsosurfaceConfig(options.dense, smallest_part=0)
    sparse = extract_isosurface(field, config)
    dense = extract_isosurface(
        field, replace(config, coarse=options.dense, rules=SearchRules(np.inf))
    )
    apart = np.concatenate([_apart(sparse, dense), _apart(dense, sparse)])
    residual = np.abs(field(sparse.vertices.astype(np.float32)))
    return {
        "resolution": options.dense,
        "furthest": float(apart.max()),
        "within_1e-6": float((apart < 1e-6).mean()),
        "vertices": [len(sparse.vertices), len(dense.vertices)],
        "residual_median_and_99%": np.percentile(residual, [50, 99]).tolist(),
    }


def _apart(one: Isosurface, other: Isosurface) -> np.ndarray:
    return np.asarray(cKDTree(other.vertices).query(one.vertices)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cloud", type=Path)
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--precision", default="auto")
    parser.add_argument("--resolutions", type=int, nargs="*", default=[128, 512])
    parser.add_argument("--exact", action="store_true")
    parser.add_argument("--views", type=Path)
    parser.add_argument("--literal", type=int, default=64)
    parser.add_argument("--dense", type=int, default=128)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()

    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        timed = pool.map(time_mesh, [(options, r) for r in options.resolutions], chunksize=1)
    result: dict[str, Any] = {"threads": options.threads, "mesh": timed}
    for row in timed:
        print(
            f"{row['resolution']}³: {row['seconds']:.2f} s ({row['cpu_seconds']:.2f} CPU s), "
            f"{row['queries']} queries = {row['share_of_dense']:.2%} of the dense grid's, "
            f"{row['vertices']} vertices, {row['peak_MB']:.0f} MB"
        )
    if options.views:
        result["views"] = views = time_views(options)
        if not views:
            raise SystemExit(f"{options.views} holds no views: no .h5 that rgrasp render wrote")
        seconds, queries = np.transpose(views)
        print(
            f"{len(views)} views of {options.views} at {options.resolutions[0]}³: "
            "{:.2f} s in the median, {:.2f} to {:.2f} s from the tenth to the ninetieth of a "
            "hundred; ".format(*np.percentile(seconds, [50, 10, 90]))
            + f"{np.median(queries):.0f} queries in the median"
        )
    if options.literal:
        result["literal"] = literal = time_literal(options)
        print(
            f"literal MISE at {literal['resolution']}³: {literal['seconds']:.1f} s, "
            f"{literal['points']} points, {literal['ms_a_point']:.2f} ms each"
        )
        for row in timed:
            # The same field, answered in batches.
            rules = SearchRules(np.inf, reach=0)
            config = IsosurfaceConfig(int(row["resolution"]), rules=rules, newton=False)
            points = extract_isosurface(network_field(reconstruct(options)), config).queries
            row["literal_seconds"] = points * literal["ms_a_point"] / 1e3
            row["times_faster"] = row["literal_seconds"] / row["seconds"]
            print(
                f"  at {row['resolution']}³ it asks {points} points: "
                f"{row['literal_seconds']:.0f} s, {row['times_faster']:.0f} times as long"
            )
    if options.dense:
        result["dense"] = dense = against_dense(options)
        print(
            f"against the dense {dense['resolution']}³ grid: {dense['within_1e-6']:.2%} of both "
            f"surfaces' vertices within 1e-6, {dense['furthest']:.1e} apart at most,"
            f" {dense['vertices'][0]} and {dense['vertices'][1]} vertices; |f| at the vertices: "
            "median {:.1e}, 99% {:.1e}".format(*dense["residual_median_and_99%"])
        )
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
