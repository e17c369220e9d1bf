"""Quality of completion on a table, for seen and hidden parts separately.

    python benchmarks/table_views.py MESHES [--checkpoint DIR] [--views N] [--sensor NAME]
        [--no-vessels]

Each mesh rests on a table in random stable poses, seen by one camera at 0.4 to 1.6 m from 11° to
75° above, alone and exactly segmented; with another --sensor than ideal, among neighbours and with
the segmentation errors of training. Prints IoU, Chamfer distance, normals; for points of the true
surface that the camera saw and that it did not see: the distance to the mesh, the agreement of
normals and the share within 3 mm; of vessels the same and how many are one closed body with a
bottom; and in how many views two samplings (seeds 0 and 1) differ.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import open3d as o3d
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pointsdf_cli.camera.pinhole import CAMERAS
from pointsdf_cli.camera.scene_views import SceneView, SceneViewConfig, SceneViews
from pointsdf_cli.camera.table_scene import SceneConfig
from pointsdf_cli.errors import InputError, leave_with_message
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.geometry.isosurface import EmptySurfaceError
from pointsdf_cli.geometry.metrics import Shape, compare, iou
from pointsdf_cli.io.meshes import LoadedMesh, find_meshes, load_mesh
from pointsdf_cli.models.meshing import mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.models.shape_model import ShapeModel

SAMPLES = 20_000
WITHIN = 0.003
VESSEL_WALLS = True
"""Whether vessels are completed by their axis (`--no-vessels`)."""
VESSELS = ("bowl", "mug", "cup", "plate", "pitcher", "pot", "glass", "jar")


class Part(NamedTuple):
    """A part of the true surface against a mesh: mean distance [m], |cos| between the normals, and
    the share of points within `WITHIN`."""

    distance: float
    normals: float
    within: float


class Row(NamedTuple):
    """One view."""

    name: str
    iou: float
    chamfer: float
    normals: float
    seen: Part
    hidden: Part
    agreement: float
    closed: bool


def meshed(model: ShapeModel, view: SceneView, seed: int) -> tuple[Array, NDArray[np.int64]] | None:
    """Vertices and faces in the camera's frame; None where the network sees nothing."""
    shape = Reconstruction.from_cloud(
        model, view.points, np.zeros(3), seed=seed, evidence=view.evidence, vessels=VESSEL_WALLS
    )
    try:
        made = mesh_reconstruction(shape, 64)
    except EmptySurfaceError:
        return None
    return made.vertices, made.faces


def visible(vertices: Array, faces: NDArray[np.int64], points: Array) -> NDArray[np.bool_]:
    """Mask of the points [N, 3] on a surface that a camera at the origin sees: nothing lies 2 mm
    before."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    rays = np.concatenate([np.zeros_like(points), points], axis=1).astype(np.float32)
    first = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    away = np.linalg.norm(points, axis=1)
    return np.asarray(first * away > away - 0.002)


def part(points: Array, normals: Array, made: Shape, near: NDArray[np.bool_]) -> Part:
    """The points [N, 3] where `near`, against the samples of a mesh."""
    distance, index = cKDTree(made.points).query(points[near])
    same = np.abs((normals[near] * made.normals[index]).sum(axis=1))
    return Part(float(distance.mean()), float(same.mean()), float((distance < WITHIN).mean()))


def score(model: ShapeModel, mesh: LoadedMesh, name: str, view: SceneView) -> Row | None:
    """One view; None where the network sees nothing."""
    first, second = (meshed(model, view, seed) for seed in (0, 1))
    if first is None or second is None:
        return None
    rng = np.random.default_rng(1)
    vertices = apply_transform(view.T_camera_object, mesh.vertices)
    truth = Shape(vertices, mesh.faces, rng, SAMPLES)
    made, other = (Shape(*each, rng, SAMPLES) for each in (first, second))
    found = compare(made, truth, rng, SAMPLES)
    few = slice(None, None, 10)
    points, normals = truth.points[few], truth.normals[few]
    seen = visible(vertices, mesh.faces, points)
    body = trimesh.Trimesh(*first)
    return Row(
        name,
        found.iou,
        found.chamfer,
        found.normals,
        part(points, normals, made, seen),
        part(points, normals, made, ~seen),
        iou(made, other, rng, SAMPLES),
        len(body.split(only_watertight=False)) == 1 and body.is_watertight,
    )


def describe(rows: Sequence[Row], title: str) -> None:
    """Print the means over views."""
    print(f"{title}: {len(rows)} views")
    whole = np.array([(row.iou, row.chamfer, row.normals) for row in rows])
    mean, median = whole.mean(axis=0), np.median(whole[:, 0])
    print(
        f"  IoU {mean[0]:.3f} (median {median:.3f}), Chamfer {1e3 * mean[1]:.2f} mm, "
        f"normals {mean[2]:.3f}"
    )
    for label, which in (("seen", "seen"), ("hidden", "hidden")):
        distance, normals, within = np.mean([getattr(row, which) for row in rows], axis=0)
        print(
            f"  {label:6s} distance {1e3 * distance:.2f} mm, normals {normals:.3f}, "
            f"within 3 mm {within:.3f}"
        )
    unstable = np.mean([row.agreement < 0.9 for row in rows])
    closed = np.mean([row.closed for row in rows])
    print(f"  two samplings below IoU 0.9: {unstable:.0%}; one closed body: {closed:.0%}")


@leave_with_message()
def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--sensor", default="ideal")
    parser.add_argument("--hiding", type=float, default=0.0, help="share with a body in front")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-vessels", action="store_true", help="The network alone.")
    options = parser.parse_args()
    global VESSEL_WALLS
    VESSEL_WALLS = not options.no_vessels
    model = load_model(options.checkpoint)
    config = SceneViewConfig(
        (options.sensor,),
        SceneConfig(resting=1.0, hiding=options.hiding),
        exact=1.0 if options.sensor == "ideal" else 0.0,
        exact_resting=1.0,
    )
    rows = []
    failed = 0
    for number, file in enumerate(find_meshes(options.meshes, "*.ply")):
        mesh = load_mesh(file)
        views = SceneViews(mesh, CAMERAS["realsense"], config)
        rng = np.random.default_rng([options.seed, number])
        for _ in range(options.views):
            try:
                view, _ = views.draw(rng)
            except InputError:
                continue
            row = score(model, mesh, file.stem, view)
            if row is None:
                failed += 1
            else:
                rows.append(row)
    if failed:
        print(f"{failed} views without a surface, which the means leave out")
    describe(rows, "all")
    vessels = [row for row in rows if any(word in row.name for word in VESSELS)]
    if vessels:
        describe(vessels, "vessels")
        describe([row for row in rows if row not in vessels], "others")


if __name__ == "__main__":
    main()
