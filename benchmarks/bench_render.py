"""`render` and `label-sdf` end to end against the bare ray tracer, in one run.

    python benchmarks/bench_render.py [--meshes DIR] [--objects N] [--views N] [--points N]

Baselines: `RaycastingScene.cast_rays` over every pixel of a 640×480 image with all cores, and
`RaycastingScene.compute_signed_distance` with all cores. Ours: the whole command, from mesh files
to finished HDF5 files, with --jobs at all cores. Enough work that the start of the processes
does not decide. About four minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np
import open3d as o3d

from pointsdf_cli.camera.pinhole import CAMERAS
from pointsdf_cli.errors import leave_with_message
from pointsdf_cli.geometry.frames import random_rotation
from pointsdf_cli.io.meshes import artifact_path, find_meshes, load_mesh

CORES = len(os.sched_getaffinity(0))
OBJECTS, VIEWS, POINTS, REPEATS = 120, 800, 200_000, 1


def run(*arguments: object) -> float:
    """Seconds of one `rgrasp` process, imports and all."""
    started = time.perf_counter()
    command = [sys.executable, "-m", "pointsdf_cli.cli.main", *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def bare_views_per_second(meshes: list[Path]) -> float:
    """Full 640×480 images by `cast_rays` alone, rays made beforehand."""
    camera = CAMERAS["reference"]
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    rays_camera = camera.back_project(u, v, np.ones_like(u, dtype=float))
    rng = np.random.default_rng(0)
    count, seconds = 0, 0.0
    for path in meshes[:8]:
        mesh = load_mesh(path)
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
        centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        scene.cast_rays(o3d.core.Tensor(np.ones((1, 6), np.float32)))  # builds the tree
        for rotation in random_rotation(rng, 10):
            rays = np.empty((480, 640, 6), dtype=np.float32)
            rays[..., :3] = centre - rotation.T @ [0, 0, 1.5]
            rays[..., 3:] = rays_camera @ rotation
            tensor = o3d.core.Tensor(rays)
            started = time.perf_counter()
            scene.cast_rays(tensor)
            seconds += time.perf_counter() - started
            count += 1
    return count / seconds


def bare_distances_per_second(files: list[Path], meshes: Path, labels: Path) -> float:
    """`compute_signed_distance` alone, at the very points that label-sdf labelled."""
    from pointsdf_cli.io.labels import read_labels

    count, seconds = 0, 0.0
    for path in files:
        mesh = load_mesh(path)
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
        points = o3d.core.Tensor(read_labels(artifact_path(path, meshes, labels)).points)
        scene.compute_signed_distance(points[:10])  # builds the tree
        started = time.perf_counter()
        scene.compute_signed_distance(points)
        seconds += time.perf_counter() - started
        count += len(points)
    return count / seconds


@leave_with_message()
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--meshes", type=Path, help="a folder of meshes; default: 120 generated")
    parser.add_argument("--objects", type=int, default=OBJECTS)
    parser.add_argument("--views", type=int, default=VIEWS, help="an object")
    parser.add_argument("--points", type=int, default=POINTS, help="an object")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        meshes = options.meshes
        if meshes is None:
            meshes = folder / "meshes"
            run("objects", "make", "--out", meshes, "--count", options.objects, "--seed", 0, "-q")
        files = find_meshes(meshes)
        views = options.views * len(files)
        points = options.points * len(files)
        bare, ours, one_job, label_bare, label_ours, label_one = ([] for _ in range(6))
        for k in range(REPEATS):
            place = [folder / f"{kind}{k}" for kind in ("v", "v1", "l", "l1")]
            bare.append(bare_views_per_second(files))
            render = ["render", "--meshes", meshes, "--views", options.views, "-q"]
            ours.append(views / run(*render, "--out", place[0], "--jobs", CORES))
            one_job.append(views / run(*render, "--out", place[1], "--jobs", 1))
            label = ["label-sdf", "--views", place[0], "--meshes", meshes, "-q"]
            label += ["--points", options.points]
            label_ours.append(points / run(*label, "--out", place[2], "--jobs", CORES))
            label_one.append(points / run(*label, "--out", place[3], "--jobs", 1))
            label_bare.append(bare_distances_per_second(files, meshes, place[2]))
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
    result = {
        "cores": CORES,
        "meshes": len(files),
        "bare cast_rays [views/s]": median(bare),
        "render, all cores [views/s]": median(ours),
        "render / bare": median(o / b for o, b in zip(ours, bare, strict=True)),
        "render, 1 → all jobs": median(o / b for o, b in zip(ours, one_job, strict=True)),
        "bare compute_signed_distance [points/s]": median(label_bare),
        "label-sdf, all cores [points/s]": median(label_ours),
        "label-sdf / bare": median(o / b for o, b in zip(label_ours, label_bare, strict=True)),
        "label-sdf, 1 → all jobs": median(
            o / b for o, b in zip(label_ours, label_one, strict=True)
        ),
        "largest process [GB]": peak,
    }
    for key, value in result.items():
        print(f"{key:42} {value:12.3f}" if isinstance(value, float) else f"{key:42} {value:12}")
    if options.json:
        options.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
