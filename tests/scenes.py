"""Table-top scenes cast by the project's own caster, with what stands where."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.raycast import MeshCaster, depth_image
from pointsdf_cli.io.clouds import Cloud
from pointsdf_cli.viz.shading import look_at

CAMERA = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)
POSE = look_at((1.25, 0.0, 0.55), (0.6, 0.0, 0.05))
Place = tuple[float, float]


def table(width: float = 1.2) -> trimesh.Trimesh:
    top = trimesh.creation.box((1.0, width, 0.02))
    top.apply_translation((0.7, 0, -0.01))
    return top


def box(size: tuple[float, float, float], at: Place, turn: float = 0.0) -> trimesh.Trimesh:
    made = trimesh.creation.box(size)
    made.apply_transform(trimesh.transformations.rotation_matrix(turn, (0, 0, 1)))
    made.apply_translation((*at, size[2] / 2))
    return made


def can(radius: float, height: float, at: Place) -> trimesh.Trimesh:
    made = trimesh.creation.cylinder(radius, height, sections=48)
    made.apply_translation((*at, height / 2))
    return made


def bowl(at: Place, radius: float = 0.08, height: float = 0.055) -> trimesh.Trimesh:
    """A bowl that is wider above, with a floor of 3 mm."""
    outline = [(0.0, 0.003), (0.04, 0.003), (radius - 0.003, height)]
    outline += [(radius, height), (0.042, 0.0), (0.0, 0.0)]
    made = trimesh.creation.revolve(np.array(outline), sections=64)
    made.apply_translation((*at, 0))
    return made


def seen(*things: trimesh.Trimesh, pose: np.ndarray = POSE, noise: float = 0.001) -> np.ndarray:
    """A depth image [480, 640], m, with noise that grows with the square of depth."""
    mesh = trimesh.util.concatenate(things)
    patch = MeshCaster(mesh.vertices, mesh.faces, CAMERA).cast(np.linalg.inv(pose))
    depth = depth_image(patch, CAMERA).astype(float)
    rng = np.random.default_rng(0)
    return np.where(depth > 0, depth + noise * depth**2 * rng.standard_normal(depth.shape), 0.0)


def cloud(depth: np.ndarray, pose: np.ndarray | None = POSE) -> Cloud:
    return cloud_of_depth(depth, CAMERA, pose)


def write_scene(folder: Path, depth: np.ndarray) -> list[object]:
    """Write depth.png (0.1 mm), K.json and T.json; the options that read them, without the pose."""
    steps = np.round(depth * 1e4).astype(np.uint16)
    Image.fromarray(steps).save(folder / "depth.png")
    (folder / "K.json").write_text(json.dumps(CAMERA.K.tolist()))
    (folder / "T.json").write_text(json.dumps(POSE.tolist()))
    return [folder / "depth.png", "--intrinsics", folder / "K.json", "--depth-scale", 0.0001]
