"""Quality of completion from real depth, and from exact views whose masks err.

    python benchmarks/real_depth.py CAPTURES MESHES [--checkpoint DIR] [--picture page.png]

CAPTURES holds folders with depth.png (0.1 mm a step), K.json, truth.json and either label.png or
T_world_camera.json; MESHES the scans that truth.json names. Prints IoU and Chamfer distance of

1. each registered object in each capture, cut out by its label (2 px too small) or by the table's
   plane: the bare cloud; cleaned; with the depth image around it; with the support plane and the
   mask grown to the depth's edge, as `plan` and `mesh` of a depth image;
2. exact views of the meshes at 1 m (fx 1067) whose masks are too small by 0, 1, 2 and 4 px, with
   the image around them: the mask as it is, and grown.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from PIL import Image
from registered import registered_objects
from scipy import ndimage

from pointsdf_cli.camera.cleaning import clean
from pointsdf_cli.camera.mask_edge import grown_mask
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.raycast import MeshCaster
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


def real_cases(captures: Path, meshes: Path) -> Iterator[tuple[Case, Case]]:
    """Every object of the captures whose pose is known: by its mask as it is, and grown."""
    for one in registered_objects(captures, meshes):
        camera, depth = one.view()
        v, u = np.nonzero(depth > 0)
        points = camera.back_project(u, v, depth[v, u])
        plane = table_plane(points[points[:, 2] < 1.6])
        height_above = points @ plane[:3] - plane[3]

        rays = None
        if one.label is None:
            mine = (height_above > PLANE_BAND) & (height_above < 0.4) & (points[:, 2] < 0.9)
            masks = mine, mine
        else:
            label = np.asarray(Image.open(one.folder / "label.png"))
            mask = ndimage.binary_erosion(label == one.label, iterations=2)
            above = np.zeros(depth.shape, dtype=bool)
            above[v, u] = height_above > PLANE_BAND
            masks = mask[v, u], grown_mask(mask, depth, camera.fx, above)[v, u]
            rays = camera.rays_of(mask & (depth <= 0))
        as_it_is, grown = (
            Case(one.name, points[m], points[~m], plane, one.mesh, one.T_camera_mesh, rays)
            for m in masks
        )
        yield as_it_is, grown


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
    rng = np.random.default_rng(1)
    truth = Shape(
        apply_transform(case.T_camera_mesh, case.mesh.vertices), case.mesh.faces, rng, SAMPLES
    )
    shape = Reconstruction.from_cloud(model, points, np.zeros(3), seed=seed, evidence=evidence)
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

    print("real depth: IoU (Chamfer mm)   bare | cleaned | with the image | with plane, mask grown")
    rows, table = [], []
    for case, grown in real_cases(options.captures, options.meshes):
        kept = case.points[clean(case.points).kept]
        more = grown.points[clean(grown.points).kept]
        found = [
            completed(model, case, case.points, None),
            completed(model, case, kept, None),
            completed(model, case, kept, evidence_of(case, kept, with_plane=False)),
            completed(model, grown, more, evidence_of(grown, more)),
        ]
        table.append([[score.iou, score.chamfer] for score, _ in found])
        said = " | ".join(f"{score.iou:.3f} ({1e3 * score.chamfer:.1f})" for score, _ in found)
        print(f"{case.name:40s} {said}", flush=True)
        truth = (apply_transform(case.T_camera_mesh, case.mesh.vertices), case.mesh.faces)
        rows.append(GalleryRow(case.name.replace(" ", "\n"), kept, found[3][1], truth))
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
