"""Pictures of training data: views with their clouds, slices of signed distance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.raycast import MeshCaster, depth_image
from pointsdf_cli.geometry.signed_distance import SignedDistance
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.io.labels import Labels
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.io.views import Views


def save_figure(figure: Figure, path: Path, dpi: int = 90) -> None:
    """Write a figure as PNG, as a whole or not at all."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=dpi, bbox_inches="tight", metadata={"Software": "rgrasp"})


def views_sheet(items: Sequence[tuple[LoadedMesh, Views]], columns: int = 4) -> Figure:
    """For each mesh one exact depth image, the 1000-point cloud of that view and of others.

    The clouds are drawn in the camera frame, as the camera sees them, coloured by depth.
    """
    figure = Figure(figsize=(2.1 * (1 + columns), 2.3 * len(items)))
    axes = figure.subplots(len(items), 1 + columns, squeeze=False)
    for row, (mesh, views) in zip(axes, items, strict=True):
        K, (width, height) = views.K, views.image_size
        camera = Camera(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        patch = MeshCaster(mesh.vertices, mesh.faces, camera).cast(views.T_camera_object[0])
        image = depth_image(patch, camera)
        if len(patch.v):  # of poses by others it may be out of sight
            top, bottom = max(patch.v.min() - 8, 0), patch.v.max() + 9
            left, right = max(patch.u.min() - 8, 0), patch.u.max() + 9
            row[0].imshow(np.ma.masked_equal(image[top:bottom, left:right], 0), cmap="viridis_r")
        row[0].set_title(f"{mesh.name[:24]}\ndepth of view 0", fontsize=7, parse_math=False)
        row[0].axis("off")
        for k, axis in enumerate(row[1:]):
            if k >= len(views.cloud):
                axis.axis("off")
                continue
            cloud = views.cloud[k]
            axis.scatter(cloud[:, 0], cloud[:, 1], c=cloud[:, 2], s=0.7, cmap="viridis_r")
            axis.set(aspect="equal", xticks=[], yticks=[])
            axis.invert_yaxis()
            across, down, deep = np.ptp(cloud, axis=0) * 100
            axis.set_title(f"view {k}\n{across:.0f} × {down:.0f} × {deep:.0f} cm", fontsize=7)
    return figure


def sdf_slices(items: Sequence[tuple[LoadedMesh, Labels]], resolution: int = 160) -> Figure:
    """Slices of the signed distance through each mesh's middle, beside the labelled points.

    Left of each pair: the field, recomputed on a plane, with its zero level. Right: the stored
    labels within a thin slab about that plane, in the same colours, so that wrong labels show.
    """
    columns = 2
    rows = -(-len(items) // columns)
    figure = Figure(figsize=(3 * 2 * columns, 3 * rows))
    axes = figure.subplots(rows, 2 * columns, squeeze=False)
    for axis in axes.ravel():
        axis.axis("off")
    for k, (mesh, labels) in enumerate(items):
        left, right = axes[k // columns, 2 * (k % columns) : 2 * (k % columns) + 2]
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        centre, half = (low + high) / 2, 0.6 * float((high - low).max())
        # Cut across the thinnest horizontal side, so that what is hollow shows.
        across = int(np.argmin((high - low)[:2]))
        plane = [axis for axis in range(3) if axis != across]
        line = np.linspace(-half, half, resolution)
        grid = np.zeros((resolution, resolution, 3)) + centre
        grid[..., plane[0]] += line[None, :]
        grid[..., plane[1]] += line[:, None]
        field = SignedDistance(mesh.vertices, mesh.faces)(grid.reshape(-1, 3))
        field = field.reshape(resolution, resolution) * 100
        # Saturate the colours beyond a third of the picture: values near zero matter.
        limit = 100 * half / 3
        extent = (-half * 100, half * 100, -half * 100, half * 100)
        style = {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}
        left.imshow(field, origin="lower", extent=extent, **style)
        left.contour(field, levels=[0.0], extent=extent, colors="k", linewidths=1)
        title = f"{mesh.name[:24]}: SDF [cm], inside blue, zero in black"
        left.set_title(title, fontsize=8, parse_math=False)
        near = np.abs(labels.points[:, across] - centre[across]) < 0.03 * half
        inside = f"{(labels.sdf[near] < 0).mean():.0%} inside" if near.any() else "none"
        points = (labels.points[near] - centre)[:, plane] * 100
        right.scatter(points[:, 0], points[:, 1], c=labels.sdf[near] * 100, s=2, **style)
        right.set(xlim=extent[:2], ylim=extent[2:], aspect="equal")
        right.set_title(f"labels in the slab, {inside}", fontsize=8)
    return figure
