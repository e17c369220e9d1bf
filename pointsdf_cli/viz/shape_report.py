"""Report on one cloud or mesh: size, frame, and pictures from several sides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.clouds import read_cloud
from pointsdf_cli.io.describe import describe, is_cloud
from pointsdf_cli.io.meshes import LoadedMesh, load_mesh
from pointsdf_cli.viz import html
from pointsdf_cli.viz.contact_sheet import shaded_view
from pointsdf_cli.viz.shape_scenes import cloud_place

AZIMUTHS = (-60.0, 30.0, 120.0)
"""Camera angles of the pictures of a mesh [degrees]."""


def shape_report(path: Path, unit: str, title: str) -> str:
    """HTML page about a cloud or mesh.

    Args:
        path: The file.
        unit: Unit of its coordinates.
        title: Title of the page.

    Raises:
        InputError: The file cannot be read.
    """
    facts = describe(path, unit)["facts"]
    if is_cloud(path):
        cloud = read_cloud(path, unit, drop_invalid=True)
        figure = _sides(apply_transform(cloud_place(cloud), cloud.points))
        sides = "from the robot, from its right and from above"
        said = f"The points as seen {sides}, coloured by height."
    else:
        figure, said = _turned(load_mesh(path, unit)), "Red is the back of a face."
    rows = [(name, str(value)) for name, value in facts.items() if value is not None]
    parts = [html.table(("", ""), rows), html.note(said), html.picture(figure, path.name)]
    return html.page(title, parts)


def _sides(points: NDArray[np.floating]) -> Figure:
    """Points [N, 3] of the world along its axes."""
    figure = Figure(figsize=(12, 4), layout="constrained")
    axes = figure.subplots(1, 3)
    for axis, (across, up) in zip(axes, ((1, 2), (0, 2), (0, 1)), strict=True):
        axis.scatter(points[:, across], points[:, up], c=points[:, 2], s=0.7, cmap="viridis")
        axis.set(aspect="equal", xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]")
    axes[0].invert_xaxis()  # y is to the left of who looks along x
    return figure


def _turned(mesh: LoadedMesh) -> Figure:
    figure = Figure(figsize=(12, 4), layout="constrained")
    for axis, azimuth in zip(figure.subplots(1, len(AZIMUTHS)), AZIMUTHS, strict=True):
        axis.imshow(shaded_view(mesh.vertices, mesh.faces, 320, azimuth=float(np.radians(azimuth))))
        axis.axis("off")
    return figure
