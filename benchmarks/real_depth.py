"""Quality of completion from real depth, and from exact views whose masks err.

    python benchmarks/real_depth.py CAPTURES MESHES [--checkpoint DIR] [--picture page.png]

CAPTURES holds folders with depth.png (0.1 mm a step), K.json, truth.json and either label.png or
T_world_camera.json; MESHES the scans that truth.json names. Prints IoU and Chamfer distance of

1. each registered object in each capture, cut out by its label (2 px too small) or by the table's
   plane: the bare cloud; cleaned; with the depth image around it; and as `plan` and `mesh` of a
   depth image see it, with the support plane and the mask grown to the depth's edge;
2. exact views of the meshes at 1 m (fx 1067) whose masks are too small by 0, 1, 2 and 4 px, with
   the image around them: the mask as it is, and grown.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from PIL import Image
from registered import Registered, registered_objects
from scipy import ndimage

from pointsdf_cli.camera.cleaning import clean
from pointsdf_cli.camera.mask_edge import grown_mask
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.raycast import MeshCaster
from pointsdf_cli.camera.scene_file import read_depth_image
from pointsdf_cli.camera.view import View
from pointsdf_cli.errors import leave_with_message
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform, random_rotation, transform
from pointsdf_cli.geometry.isosurface import EmptySurfaceError
from pointsdf_cli.geometry.metrics import Score, Shape, compare, failure
from pointsdf_cli.geometry.visibility import PLANE_BAND, ViewEvidence, visibility_image
from pointsdf_cli.io.meshes import LoadedMesh, find_meshes, load_mesh
from pointsdf_cli.models.meshing import mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.planning.scene_input import stand_on_table
from pointsdf_cli.planning.table_top import look_at_table
from pointsdf_cli.planning.target import completed as planner_completed
from pointsdf_cli.viz.reconstruction_gallery import GalleryRow, draw_gallery

SAMPLES = 20_000


class Case(NamedTuple):
    """One object as seen; points in the camera frame, m."""

    name: str
    points: Array
    others: Array
    plane: Array | None
    mesh: LoadedMesh
    T_camera_mesh: Array
    rays: Array | None = None
    """[K, 2], tangents of the mask's pixels without depth."""


def real_cases(captures: Path, meshes: Path) -> Iterator[tuple[Case, View]]:
    """Every object of the captures whose pose is known, and the planner's view of it."""
    for one in registered_objects(captures, meshes):
        camera, depth = one.view()
        v, u = np.nonzero(depth > 0)
        points = camera.back_project(u, v, depth[v, u])
        plane = table_plane(points[points[:, 2] < 1.6])
        height_above = points @ plane[:3] - plane[3]

        rays = mask = None
        if one.label is None:
            mine = (height_above > PLANE_BAND) & (height_above < 0.4) & (points[:, 2] < 0.9)
        else:
            label = np.asarray(Image.open(one.folder / "label.png"))
            mask = ndimage.binary_erosion(label == one.label, iterations=2)
            mine, rays = mask[v, u], camera.rays_of(mask & (depth <= 0))
        case = Case(one.name, points[mine], points[~mine], plane, one.mesh, one.T_camera_mesh, rays)
        yield case, planned_view(one, mask)


def planned_view(one: Registered, mask: NDArray[np.bool_] | None) -> View:
    """The view that `plan` has of the object in a depth image, with a mask [height, width] if it
    does not stand alone."""
    camera, _ = one.view()
    cloud = read_depth_image(one.folder / "depth.png", one.folder / "K.json", depth_scale=1e-4)
    if mask is not None and cloud.pixels is not None:
        u, v = cloud.pixels.astype(np.int64).T
        measured = np.zeros_like(mask)
        measured[v, u] = True
        rays = camera.rays_of(mask & ~measured)
        cloud = replace(cloud, mask=mask[v, u], mask_rays=rays)
    on_table, _ = stand_on_table(cloud, one.name, (0.6, 0.0))
    return look_at_table([on_table], [one.name], None, np.zeros(0)).views[0]


def exact_cases(meshes: Path, erosion: int, grown: bool = False, most: int = 13) -> Iterator[Case]:
    """One exact view of each of `most` meshes, seen from above before a wall 0.5 m behind."""
    camera = Camera(640, 480, 1067.0, 1067.0, 319.5, 239.5)
    rng = np.random.default_rng(0)
    files = find_meshes(meshes, "*.ply")
    for file in files[:: max(1, len(files) // most)][:most]:
        mesh = load_mesh(file)
        centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        rotation = random_rotation(rng)
        pose = transform(rotation, np.array([0, 0, 1.0]) - rotation @ centre)
        window = MeshCaster(mesh.vertices, mesh.faces, camera).cast_window(pose, margin=0.45)
        full = np.isfinite(window.depth)
        depth = np.where(full, window.depth, 1.5)
        mask = ndimage.binary_erosion(full, iterations=erosion) if erosion else full
        mask = grown_mask(mask, depth, camera.fx) if grown else mask
        rows, columns = np.indices(depth.shape).reshape(2, -1)
        points = camera.back_project(
            columns + window.origin[0], rows + window.origin[1], depth.ravel()
        )
        inside = mask.ravel()
        if inside.sum() >= 60:
            yield Case(file.stem, points[inside], points[~inside], None, mesh, pose)


def table_plane(points: Array) -> Array:
    """The largest plane [4] that faces the camera, its normal towards it (RANSAC, Open3D)."""
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points[::5]))
    o3d.utility.random.seed(0)
    (a, b, c, d), _ = cloud.segment_plane(0.005, 3, 1000)
    plane = np.array([a, b, c, -d])
    return plane if plane[3] < 0 else -plane


def evidence_of(case: Case, points: Array, with_plane: bool = True) -> ViewEvidence:
    """Observed space around the object."""
    plane = case.plane if with_plane else None
    return ViewEvidence(visibility_image(points, case.others, plane, None, case.rays), plane)


def completed(
    model: ShapeModel, case: Case, points: Array, evidence: ViewEvidence | None, seed: int = 0
) -> tuple[Score, tuple[Array, NDArray[np.int64]] | None]:
    """The score of one reconstruction, and its mesh in the camera frame."""
    shape = Reconstruction.from_cloud(model, points, np.zeros(3), seed=seed, evidence=evidence)
    return scored(shape, case.T_camera_mesh, case.mesh)


def scored(
    shape: Reconstruction, pose: Array, mesh: LoadedMesh
) -> tuple[Score, tuple[Array, NDArray[np.int64]] | None]:
    """The score of a reconstruction by a scan at a pose [4, 4], and its mesh."""
    rng = np.random.default_rng(1)
    truth = Shape(apply_transform(pose, mesh.vertices), mesh.faces, rng, SAMPLES)
    try:
        made = mesh_reconstruction(shape, 64)
    except EmptySurfaceError:
        return failure(truth.diagonal), None
    prediction = Shape(made.vertices, made.faces, rng, SAMPLES)
    return compare(prediction, truth, rng, SAMPLES), (made.vertices, made.faces)


@leave_with_message()
def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("meshes", type=Path)
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    model = load_model(options.checkpoint)

    print("real depth: IoU (Chamfer mm)   bare | cleaned | with the image | as `plan`")
    rows, table = [], []
    for case, view in real_cases(options.captures, options.meshes):
        kept = case.points[clean(case.points).kept]
        T_world_mesh = view.T_world_camera @ case.T_camera_mesh
        found = [
            completed(model, case, case.points, None),
            completed(model, case, kept, None),
            completed(model, case, kept, evidence_of(case, kept, with_plane=False)),
            scored(planner_completed(model, view, seed=0), T_world_mesh, case.mesh),
        ]
        table.append([[score.iou, score.chamfer] for score, _ in found])
        said = " | ".join(f"{score.iou:.3f} ({1e3 * score.chamfer:.1f})" for score, _ in found)
        print(f"{case.name:40s} {said}", flush=True)
        truth = (apply_transform(T_world_mesh, case.mesh.vertices), case.mesh.faces)
        rows.append(GalleryRow(case.name.replace(" ", "\n"), view.in_world, found[3][1], truth))
    mean = np.mean(table, axis=0)
    print(f"{'mean':40s} " + " | ".join(f"{iou:.3f} ({1e3 * cd:.1f})" for iou, cd in mean))
    if options.picture:
        draw_gallery(options.picture, rows)

    print("exact views, mask too small by:   as it is | grown")
    for erosion in (0, 1, 2, 4):
        ious = []
        for grows in (False, True):
            cases = exact_cases(options.meshes, erosion, grows)
            known = [(case, evidence_of(case, case.points)) for case in cases]
            ious.append(np.mean([completed(model, c, c.points, e)[0].iou for c, e in known]))
        print(f"{erosion} px{'':36s} {ious[0]:.3f} | {ious[1]:.3f}", flush=True)


if __name__ == "__main__":
    main()
