"""Evaluation of reconstructions for `eval-sdf`, as in Table I (docs/method.md, "Table I").

Networks work in the camera's frame. Their meshes are then transformed to the true mesh's frame,
where one set of samples and search trees serves all views of an object; the metrics are invariant
to rigid motion. Volumes are those of the meshes, as in Occupancy Networks, not of the field: the
score is that of the output of `rgrasp mesh`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Surface
from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.geometry.isosurface import EmptySurfaceError
from pointsdf_cli.geometry.metrics import SAMPLES, Score, Shape, compare, failure
from pointsdf_cli.io.batch import StageReport, task_seed
from pointsdf_cli.io.meshes import LoadedMesh, find_meshes, load_mesh, named_artifacts
from pointsdf_cli.io.provenance import git_commit
from pointsdf_cli.io.views import Views, read_views, read_views_header
from pointsdf_cli.models.meshing import mesh_reconstruction
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import load_cached, use_threads
from pointsdf_cli.models.shape_model import ShapeModel
from pointsdf_cli.training.precision import autocast_dtype
from pointsdf_cli.training.sdf_table import PUBLISHED, ScoredView, summarise, table_lines
from pointsdf_cli.viz.reconstruction_gallery import GalleryRow, draw_gallery

PARTIAL_HULL = "convex hull of the partial cloud"
TRUTH_HULL = "convex hull of the truth"
SETTINGS = ("resolution", "samples", "precision", "exact", "seed")
"""Settings that are told with the results."""


@dataclass(frozen=True)
class EvalConfig:
    """Subject and resolution of an evaluation.

    Attributes:
        checkpoints: Label and directory of each network.
        resolution: Resolution of the extracted meshes.
        views: Number of views of each object, from the first; 0 for all.
        samples: Number of points of each metric.
        precision: Precision of the networks: auto, bfloat16 or float32.
        exact: Evaluate the networks everywhere, see `mesh_reconstruction`.
        seed: Random seed of the resampled clouds and of the metrics' points.

    Raises:
        InputError: A number is out of its range.
    """

    checkpoints: tuple[tuple[str, Path], ...]
    resolution: int = 128
    views: int = 10
    samples: int = SAMPLES
    precision: str = "auto"
    exact: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        autocast_dtype(self.precision, torch.device("cpu"))
        if self.views < 0:
            raise InputError(f"{self.views} views", where="--count", allowed="0 (all) or more")
        if self.samples < 100:
            raise InputError(
                f"{self.samples} samples", where="--samples", allowed="at least 100 (100000)"
            )


class EvalTask(NamedTuple):
    """One object for one worker process."""

    name: str
    views: Path
    mesh: Path
    config: EvalConfig


def evaluate_object(task: EvalTask) -> list[ScoredView]:
    """Scores of every network and trivial baseline on the views of one object.

    Raises:
        InputError: The mesh or the views cannot be used, or do not belong together.
    """
    use_threads(1)
    views, mesh = _load(task)
    rng = task_seed(task.config.seed, task.name)
    samples = task.config.samples
    truth = Shape(mesh.vertices, mesh.faces, rng, samples)
    hull = _score(convex_hull(mesh.vertices), np.eye(4), truth, rng, samples)
    scored = []
    for view in range(len(views.cloud))[: task.config.views or None]:
        to_object = invert_transform(views.T_camera_object[view])
        surfaces: dict[str, Surface | None] = {
            label: reconstruct(load_cached(path), views, task, view)[1]
            for label, path in task.config.checkpoints
        }
        surfaces[PARTIAL_HULL] = convex_hull(views.cloud[view])
        for method, surface in surfaces.items():
            # Random numbers of a method do not depend on the other methods.
            drawn = task_seed(task.config.seed, f"{task.name} {view}")
            score = _score(surface, to_object, truth, drawn, samples)
            scored.append(ScoredView(method, task.name, view, score))
        scored.append(ScoredView(TRUTH_HULL, task.name, view, hull))
    return scored


def make_tasks(
    views: Path, meshes: Path, config: EvalConfig, aside: Collection[str] = (), pattern: str = "*"
) -> list[EvalTask]:
    """One task for each mesh with views.

    Raises:
        InputError: There are no meshes, none has views, or none has a name in `aside`.
    """
    found = named_artifacts(find_meshes(meshes, pattern), meshes, views)
    tasks = [
        EvalTask(name, artifact, mesh, config)
        for name, (mesh, artifact) in found.items()
        if artifact.exists()
    ]
    if not tasks:
        raise InputError(
            f"no mesh of {meshes} has its views here",
            where=views,
            hint=f"rgrasp render --meshes {meshes} --out {views}",
        )
    names = [Path(task.name).name for task in tasks]
    if unknown := set(aside) - set(names):
        what = f"no object {', '.join(sorted(unknown))}"
        raise InputError(what, where="--apart", allowed=", ".join(names[:60]))
    return tasks


def results(
    report: StageReport[list[ScoredView]],
    config: EvalConfig,
    folders: tuple[Path, Path],
    aside: Collection[str],
    beside: str | None,
) -> tuple[dict[str, Any], list[str]]:
    """Table I in plain types, and as lines of text.

    Args:
        report: Scores by object.
        config: Settings of the evaluation.
        folders: Views and meshes.
        aside: Names of the objects with a table of their own.
        beside: Data set of the published rows; None for none.
    """
    main, poor = _apart(report, aside)
    tables = {"table": summarise(main, config.seed), "apart": summarise(poor, config.seed)}
    lines = table_lines(tables["table"], beside)
    if poor:
        lines += ["", f"apart: {', '.join(sorted(aside))}", *table_lines(tables["apart"])]
    result = {
        **tables,
        "published": PUBLISHED.get(beside or "", {}),
        "checkpoints": {label: str(path) for label, path in config.checkpoints},
        "views_folder": str(folders[0]),
        "meshes_folder": str(folders[1]),
        "apart_objects": sorted(aside),
        "refused": {name: error.what for name, error in report.refused},
        **{name: getattr(config, name) for name in SETTINGS},
        "git_commit": git_commit(),
        "seconds": round(report.seconds, 1),
    }
    return result, lines


def draw_extremes(
    path: Path,
    tasks: Sequence[EvalTask],
    report: StageReport[list[ScoredView]],
    aside: Collection[str],
    each: int,
) -> None:
    """Draw the `each` best, median and worst views of the first network, without those aside."""
    path.unlink(missing_ok=True)  # an older table's would stay where nothing is drawn
    main, _ = _apart(report, aside)
    if not each or not main:
        return
    by_name = {task.name: task for task in tasks}
    label = tasks[0].config.checkpoints[0][0]
    chosen = best_median_worst([row for row in main if row.method == label], each)
    draw_gallery(path, [gallery_row(by_name[v.object_name], v, note) for note, v in chosen])


def _apart(
    report: StageReport[list[ScoredView]], aside: Collection[str]
) -> tuple[list[ScoredView], list[ScoredView]]:
    scored = [row for rows in report.made.values() for row in rows]
    poor = [row for row in scored if Path(row.object_name).name in aside]
    return [row for row in scored if Path(row.object_name).name not in aside], poor


def reconstruct(
    model: ShapeModel, views: Views, task: EvalTask, view: int
) -> tuple[Reconstruction, Surface | None]:
    """Reconstruct one view; also its mesh in the camera's frame, or None without a surface."""
    reconstruction = Reconstruction.from_cloud(
        model,
        views.cloud[view].astype(np.float64),
        np.zeros(3),
        seed=task.config.seed + view,
        evidence=views.evidence[view],
        tries=1,  # as the paper reads a view
    ).in_precision(autocast_dtype(task.config.precision, torch.device("cpu")))
    try:
        mesh = mesh_reconstruction(reconstruction, task.config.resolution, exact=task.config.exact)
    except EmptySurfaceError:
        return reconstruction, None
    return reconstruction, (mesh.vertices, mesh.faces)


def gallery_row(task: EvalTask, scored: ScoredView, note: str) -> GalleryRow:
    """Row of the gallery for one scored view of the first network, reconstructed again."""
    views, mesh = _load(task)
    pose = views.T_camera_object[scored.view]
    model = load_cached(task.config.checkpoints[0][1])
    reconstruction, surface = reconstruct(model, views, task, scored.view)
    score = scored.score
    return GalleryRow(
        title=f"{note}\n{Path(task.name).name}\nIoU {score.iou:.2f}\n"
        f"Chamfer {1e3 * score.chamfer:.1f} mm\nnormals {score.normals:.2f}",
        cloud=views.cloud[scored.view],
        prediction=surface,
        truth=(apply_transform(pose, mesh.vertices), mesh.faces),
        sdf=reconstruction.sdf,
    )


def best_median_worst(scored: Sequence[ScoredView], each: int) -> list[tuple[str, ScoredView]]:
    """`each` views by IoU from the top, the middle and the bottom, no object twice."""
    ranked = sorted(scored, key=lambda view: -view.score.iou)
    by_middle = sorted(range(len(ranked)), key=lambda i: abs(i - len(ranked) // 2))
    middle = [ranked[i] for i in by_middle]
    chosen: list[tuple[str, ScoredView]] = []
    names: set[str] = set()
    for note, order in (("best", ranked), ("worst", ranked[::-1]), ("median", middle)):
        for view in order:
            if len([1 for taken, _ in chosen if taken == note]) == each:
                break
            if view.object_name not in names:
                names.add(view.object_name)
                chosen.append((note, view))
    return sorted(chosen, key=lambda pair: ("best", "median", "worst").index(pair[0]))


def convex_hull(points: NDArray[np.floating]) -> Surface | None:
    """The convex hull of points [N, 3] as a closed mesh; None if they lie in a plane."""
    try:
        hull = ConvexHull(points.astype(np.float64))
    except QhullError:
        return None
    faces = hull.simplices.copy()
    corners = hull.points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return hull.points, faces


def _load(task: EvalTask) -> tuple[Views, LoadedMesh]:
    mesh = load_mesh(task.mesh, read_views_header(task.views).unit)
    views = read_views(task.views)
    if views.mesh_hash != mesh.sha256:
        raise InputError(
            f"shows another version of {task.mesh.name} than the one in {task.mesh.parent}",
            where=task.views,
            hint=f"rgrasp render --meshes {task.mesh.parent} --out {task.views.parent} --force",
        )
    return views, mesh


def _score(
    surface: Surface | None,
    to_object: NDArray[np.float64],
    truth: Shape,
    rng: np.random.Generator,
    samples: int,
) -> Score:
    if surface is None:
        return failure(truth.diagonal)
    vertices, faces = surface
    prediction = Shape(apply_transform(to_object, vertices), faces, rng, samples)
    return compare(prediction, truth, rng, samples)
