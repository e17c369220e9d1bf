"""Gallery of input, reconstruction and truth: one row an object, drawn headless.

Each row shows the input cloud from the camera, the reconstruction and the truth from the camera's
side and from the far side that it could not see, and a slice of the signed distance field along
the line of sight (the paper's figure 3): what the network believes about the unseen half.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pointsdf_cli.geometry.field import FieldFunction
from pointsdf_cli.geometry.signed_distance import SignedDistance
from pointsdf_cli.io.atomic import atomic_path
from pointsdf_cli.viz.contact_sheet import shaded_view

TITLES = (
    "seen by the camera",
    "reconstruction,\ncamera side",
    "truth,\ncamera side",
    "reconstruction,\nfar side",
    "truth,\nfar side",
    "SDF along the sight [cm]\n(camera at the left)",
)
TRUTH_COLUMNS, SLICE_COLUMN = (2, 4), 5
# Camera axes (right, down, forward) to a room with z up, the camera looking along +y.
ROOM = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=np.float64)
CAMERA_SIDE = -np.pi / 2 + 0.45
ELEVATION = 0.35
RECONSTRUCTION, TRUTH = (0.93, 0.66, 0.38), (0.56, 0.67, 0.82)
TILE = 260
SLICE = 120
"""Samples along each side of a slice."""


@dataclass(frozen=True)
class GalleryRow:
    """One reconstruction; everything in the camera's frame, in metres.

    Attributes:
        title: Name and scores, at the left of the row.
        cloud: [N, 3] what the camera saw.
        prediction: Vertices and faces, or None where there was no reconstruction.
        truth: Vertices and faces, or None where it is not known.
        sdf: The reconstruction's field, [N, 3] → [N]; None leaves the slice out.
    """

    title: str
    cloud: NDArray[np.floating]
    prediction: tuple[NDArray[np.floating], NDArray[np.integer]] | None
    truth: tuple[NDArray[np.floating], NDArray[np.integer]] | None
    sdf: FieldFunction | None = None


def draw_gallery(path: Path | str, rows: Sequence[GalleryRow]) -> None:
    """Draw `rows` as one PNG (or PDF, by the suffix); columns of truth and of the field only where
    one is known."""
    shown = dict.fromkeys(TRUTH_COLUMNS, any(row.truth for row in rows))
    shown[SLICE_COLUMN] = any(row.sdf for row in rows)
    columns = [k for k in range(len(TITLES)) if shown.get(k, True)]
    # No pyplot, no display.
    figure = Figure(figsize=(2.08 * len(columns), 2.1 * len(rows) + 0.5), dpi=110)
    axes = figure.subplots(len(rows), len(columns), squeeze=False)
    for axis, column in zip(axes[0], columns, strict=True):
        axis.set_title(TITLES[column], fontsize=8)
    for row, line in zip(rows, axes, strict=True):
        _draw_row(row, dict(zip(columns, line, strict=True)))
    figure.tight_layout(pad=0.4)
    with atomic_path(path) as temporary:
        figure.savefig(temporary)


def _draw_row(row: GalleryRow, axes: Mapping[int, Any]) -> None:
    surfaces = [surface[0] for surface in (row.truth, row.prediction) if surface]
    framing = np.concatenate([row.cloud, *surfaces]) @ ROOM.T
    _draw_cloud(axes[0], row.cloud, framing)
    # The title stands left of the row, where an axis without ticks has its label.
    # A file's name is no formula, even with dollars in it.
    style = {"fontsize": 7, "rotation": 0, "ha": "right", "va": "center", "parse_math": False}
    title = row.title.encode("utf-8", "backslashreplace").decode()  # names may be no UTF-8
    axes[0].set_ylabel(title, **style)
    for column, shape, colour, azimuth in (
        (1, row.prediction, RECONSTRUCTION, CAMERA_SIDE),
        (2, row.truth, TRUTH, CAMERA_SIDE),
        (3, row.prediction, RECONSTRUCTION, CAMERA_SIDE + np.pi),
        (4, row.truth, TRUTH, CAMERA_SIDE + np.pi),
    ):
        if column not in axes:
            continue
        axis = axes[column]
        _bare(axis)
        if shape is None:
            axis.text(0.5, 0.5, "no surface", ha="center", va="center", transform=axis.transAxes)
            continue
        vertices, faces = np.asarray(shape[0], np.float64) @ ROOM.T, np.asarray(shape[1])
        axis.imshow(shaded_view(vertices, faces, TILE, colour, azimuth, ELEVATION, framing=framing))
    if SLICE_COLUMN in axes:
        if row.sdf is None:
            _bare(axes[SLICE_COLUMN])
        else:
            _draw_slice(axes[SLICE_COLUMN], row, row.sdf)


def _draw_cloud(axis: Any, cloud: NDArray[np.floating], framing: NDArray[np.floating]) -> None:
    """The points as the camera sees them, near ones dark."""
    _bare(axis)
    order = np.argsort(-cloud[:, 2])
    axis.scatter(*cloud[order, :2].T, c=cloud[order, 2], cmap="viridis", s=1.5, linewidths=0)
    middle = (framing.min(axis=0) + framing.max(axis=0)) / 2
    half = 0.54 * np.ptp(framing, axis=0)[[0, 2]].max()
    across, down = (middle[0] - half, middle[0] + half), (-middle[2] + half, -middle[2] - half)
    axis.set(xlim=across, ylim=down, aspect="equal")


def _draw_slice(axis: Any, row: GalleryRow, sdf: FieldFunction) -> None:
    """The field in the plane through the cloud's centre that holds the line of sight (y and z)."""
    surface = row.truth or row.prediction
    everything = np.concatenate([row.cloud, surface[0]]) if surface else row.cloud
    low, high = everything.min(axis=0), everything.max(axis=0)
    middle, half = (low + high) / 2, 0.62 * (high - low)[1:].max()
    ticks = np.linspace(-half, half, SLICE)
    depth, down = np.meshgrid(middle[2] + ticks, middle[1] + ticks)
    x = np.median(row.cloud[:, 0])
    points = np.stack([np.full_like(depth, x), down, depth], axis=-1).reshape(-1, 3)
    field = np.asarray(sdf(points), np.float64).reshape(depth.shape)
    reach = half / 2
    across, along = 100 * (depth - middle[2]), 100 * (down - middle[1])
    axis.pcolormesh(across, along, field, cmap="RdBu_r", vmin=-reach, vmax=reach, shading="auto")
    axis.contour(across, along, field, levels=[0.0], colors=["#b05500"], linewidths=1.4)
    if row.truth:
        truth = SignedDistance(*row.truth)(points).reshape(depth.shape)
        axis.contour(
            across, along, truth, levels=[0.0], colors=["k"], linewidths=0.9, linestyles=":"
        )
    near = np.abs(row.cloud[:, 0] - x) < 0.04 * half
    beside = 100 * (row.cloud[near] - middle)
    axis.scatter(beside[:, 2], beside[:, 1], s=3, c="k")
    axis.invert_yaxis()
    axis.set_aspect("equal")
    axis.tick_params(labelsize=5, length=2, pad=1)


def _bare(axis: Any) -> None:
    axis.set(xticks=[], yticks=[])
    for spine in axis.spines.values():
        spine.set_visible(False)
