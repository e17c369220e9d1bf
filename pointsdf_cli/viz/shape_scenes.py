"""Clouds, meshes, views and labels as scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.geometry.frames import apply_transform, invert_transform, transform
from pointsdf_cli.io.clouds import Cloud, read_cloud
from pointsdf_cli.io.labels import read_labels
from pointsdf_cli.io.meshes import load_mesh
from pointsdf_cli.io.views import read_views
from pointsdf_cli.viz.scene import Part, Scene, axes, by_height
from pointsdf_cli.viz.scene_sources import MESH_COLOUR, SceneOptions, named_mesh, spread

# Orientation of a cloud in the camera's frame without a camera pose: the viewing direction is
# ahead, the image's downward direction is down.
T_UPRIGHT_CAMERA = transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [0, 0, 0])


def cloud_scene(path: Path, options: SceneOptions) -> Scene:
    """Scene of a cloud in the world, or upright if its camera's pose is not known."""
    cloud = read_cloud(path, options.unit, drop_invalid=True)
    placed = "world"
    if cloud.frame == "camera":
        known = cloud.T_world_camera is not None
        placed = "camera, shown in the world" if known else "camera, set upright"
    T_show = cloud_place(cloud)
    points = apply_transform(T_show, cloud.points).astype(np.float32)
    colours = by_height(points)
    if cloud.colours is not None:
        colours = (cloud.colours / 255).astype(np.float32)
    parts = [Part(path.name, "cloud", "points", points, None, colours), axes("world", "axes", 0.1)]
    extent = " × ".join(f"{side:.3f}" for side in np.ptp(points, axis=0))
    facts = (("cloud", f"{len(points)} points, {extent} m"), ("frame", placed))
    return Scene(path.name, tuple(parts), facts=facts)


def cloud_place(cloud: Cloud) -> NDArray[np.float64]:
    """Pose [4, 4] of a cloud's frame in the world shown."""
    if cloud.frame == "world":
        return np.eye(4)
    return T_UPRIGHT_CAMERA if cloud.T_world_camera is None else cloud.T_world_camera


def mesh_scene(path: Path, options: SceneOptions) -> Scene:
    """A mesh in its own frame."""
    mesh = load_mesh(path, options.unit)
    size = float(np.ptp(mesh.vertices, axis=0).max())
    surface = Part(path.name, "mesh", "mesh", mesh.vertices, mesh.faces, MESH_COLOUR)
    extent = " × ".join(f"{side:.3f}" for side in np.ptp(mesh.vertices, axis=0))
    facts = (
        ("mesh", f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces"),
        ("extent", f"{extent} m"),
        ("repair", mesh.repair),
    )
    return Scene(path.name, (surface, axes("mesh", "axes", size / 2)), facts=facts)


def views_scene(path: Path, options: SceneOptions) -> Scene:
    """The views of one mesh around it, one a frame, each with the camera that saw it."""
    views = read_views(path)
    chosen = spread(len(views.cloud), options.most)
    width, height = views.image_size
    parts, poses = named_mesh(path, options), invert_transform(views.T_camera_object[chosen])
    for frame, k in enumerate(chosen):
        points, colours = apply_transform(poses[frame], views.cloud[k]), by_height(views.cloud[k])
        parts.append(Part(f"view {k}", "cloud", "points", points, None, colours, frame=frame))
    parts += [_frustum(views.K, width, height, 0.1), axes("mesh", "axes", 0.05)]
    facts = (("views", str(len(views.cloud))), ("mesh", views.mesh_file))
    captions = tuple(f"view {k}" for k in chosen)
    return Scene(
        path.name, tuple(parts), ("camera",), poses[:, None], captions, "view", facts=facts
    )


def labels_scene(path: Path, options: SceneOptions) -> Scene:
    """Points with their signed distance: inside blue, outside red, the surface white."""
    labels = read_labels(path)
    chosen = spread(len(labels.sdf), 20_000)
    points, sdf = labels.points[chosen], labels.sdf[chosen]
    strength = np.clip(np.abs(sdf) / max(float(np.percentile(np.abs(sdf), 90)), 1e-9), 0, 1)
    colours, fade = np.ones((len(sdf), 3), np.float32), 1 - strength[:, None]
    inside = sdf < 0
    colours[inside, :2] = fade[inside]
    colours[sdf > 0, 1:] = fade[sdf > 0]
    parts = tuple(
        Part(name, name, "points", points[mask], None, colours[mask])
        for name, mask in (("inside", inside), ("outside", ~inside))
    )
    facts = (("points", str(len(labels.sdf))), ("shown", str(len(chosen))))
    return Scene(path.name, parts, facts=facts)


def _frustum(K: NDArray[np.float64], width: int, height: int, depth: float) -> Part:
    """The outline of a camera's view to `depth` [m], in its own frame, fixed to body 0."""
    corners = np.array([[u, v, 1.0] for u, v in ((0, 0), (width, 0), (width, height), (0, height))])
    edge = depth * corners @ np.linalg.inv(K).T
    pairs = [(np.zeros(3), corner) for corner in edge]
    pairs += [(edge[k], edge[(k + 1) % 4]) for k in range(4)]
    vertices = np.array(pairs).reshape(-1, 3)
    return Part("camera", "camera", "lines", vertices, None, (0.2, 0.2, 0.2), 0)
