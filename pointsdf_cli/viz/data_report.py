"""Report on a folder of views and labels: contents and pictures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pointsdf_cli.io.labels import Labels, read_labels
from pointsdf_cli.io.meshes import LoadedMesh
from pointsdf_cli.io.views import Views, read_views
from pointsdf_cli.viz import html
from pointsdf_cli.viz.scene_sources import mesh_of
from pointsdf_cli.viz.sheets import sdf_slices, views_sheet

SHOWN = 6
"""Number of objects drawn of each kind, spread evenly over the folder."""


@dataclass(frozen=True)
class DataFolder:
    """Artifacts by schema, and files that may be their meshes."""

    views: list[Path]
    labels: list[Path]
    meshes: list[Path]


def data_report(found: DataFolder, title: str) -> str:
    """The page, as HTML."""
    counts = [("views", len(found.views)), ("labels", len(found.labels))]
    parts = [html.table(("artifact", "files"), counts)]
    seen, labelled = sample_items(found)
    if seen:
        header = ("mesh", "views", "points a view", "noise at 1.5 m [mm]", "repair")
        of_views = [
            (m.name, len(v.cloud), v.cloud.shape[1], 1e3 * v.noise, v.mesh_repair) for m, v in seen
        ]
        parts += [
            html.heading("Views"),
            html.note("Each cloud as its camera sees it, coloured by depth."),
            html.picture(views_sheet(seen), "views and their clouds"),
            html.table(header, of_views),
        ]
    if labelled:
        of_labels = [(mesh.name, *_figures_of(labels)) for mesh, labels in labelled]
        parts += [
            html.heading("Signed distances"),
            html.note("Left the field on a plane through the middle, right the stored labels."),
            html.picture(sdf_slices(labelled), "slices of signed distance"),
            html.table(("mesh", "points", "inside [%]", "median |distance| [mm]"), of_labels),
        ]
    if not seen and not labelled:
        absent = "No pictures: the meshes were not found. Give their folder by --meshes."
        parts.append(html.note(absent))
    return html.page(title, parts)


def _figures_of(labels: Labels) -> tuple[int, float, float]:
    """Number of labels, the share of them inside [%] and their median distance [mm]."""
    inside, distance = (labels.sdf < 0).mean(), np.median(np.abs(labels.sdf))
    return len(labels.sdf), 100 * float(inside), 1e3 * float(distance)


def sample_items(
    found: DataFolder,
) -> tuple[list[tuple[LoadedMesh, Views]], list[tuple[LoadedMesh, Labels]]]:
    """The artifacts shown on the page, for pictures as files."""
    views = [(mesh, read_views(path)) for path, mesh in _with_mesh(found.views, found.meshes)]
    labels = [(mesh, read_labels(path)) for path, mesh in _with_mesh(found.labels, found.meshes)]
    return views, labels


def _with_mesh(paths: list[Path], meshes: list[Path]) -> Iterator[tuple[Path, LoadedMesh]]:
    """Some of the artifacts, spread evenly, each with its mesh; without those whose mesh is not
    found."""
    if not paths:
        return
    for k in np.unique(np.linspace(0, len(paths) - 1, SHOWN).astype(int)):
        _, mesh = mesh_of(paths[k], meshes)
        if mesh is not None:
            yield paths[k], mesh
