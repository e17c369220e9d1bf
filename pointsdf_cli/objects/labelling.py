"""The `label-sdf` stage: signed distances for every mesh that has views."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from pointsdf_cli.errors import InputError, as_input_error
from pointsdf_cli.geometry.sdf_sampling import SamplingConfig, sample_sdf
from pointsdf_cli.io.batch import task_seed
from pointsdf_cli.io.hdf5 import OptionsDifferError, artifacts_below, is_complete, open_hdf5
from pointsdf_cli.io.labels import SCHEMA, VERSION, Labels, write_labels
from pointsdf_cli.io.meshes import find_meshes, load_mesh
from pointsdf_cli.io.views import read_views_header


@dataclass(frozen=True)
class LabelTask:
    """One mesh to label, for one worker process; `mesh` is None where it is missing."""

    name: str
    views: Path
    mesh: Path | None
    out: Path
    config: SamplingConfig
    seed: int
    force: bool = False


@dataclass(frozen=True)
class LabelSummary:
    """Number of labelled points, and the fractions inside."""

    points: int
    inside_fraction: float


def find_label_tasks(
    views: Path,
    meshes: Path,
    out: Path,
    config: SamplingConfig,
    seed: int,
    force: bool,
    pattern: str = "*",
) -> list[LabelTask]:
    """One task for every views file and its mesh.

    Raises:
        InputError: A folder is missing or empty, or no views file's mesh is in `meshes`.
    """
    if not views.is_dir():
        raise InputError(
            "no such folder of views", where=views, hint="rgrasp render --meshes DIR --out DIR"
        )
    files = artifacts_below(views)
    if not files:
        raise InputError("holds no views (*.h5)", where=views, hint="rgrasp render --meshes DIR")
    root = meshes if meshes.is_dir() else meshes.parent
    found = find_meshes(meshes, pattern)
    by_place = {mesh.relative_to(root).with_suffix(""): mesh for mesh in found}
    tasks = []
    for file in files:
        place = file.relative_to(views).with_suffix("")
        mesh = by_place.get(place)
        path = out / f"{place}.h5"
        tasks.append(LabelTask(place.as_posix(), file, mesh, path, config, seed, force))
    if all(task.mesh is None for task in tasks):
        raise _no_mesh(tasks[0])
    return tasks


def _no_mesh(task: LabelTask) -> InputError:
    return InputError(
        f"no mesh {task.name}.* for these views",
        where=task.views,
        allowed="a mesh in --meshes at the place where render found it",
    )


def label_file(task: LabelTask) -> LabelSummary | None:
    """Label one mesh; None if its labels exist already.

    Raises:
        InputError: The mesh is missing, is not the one that the views show, or cannot be labelled.
    """
    if task.mesh is None:
        raise _no_mesh(task)
    config = asdict(task.config) | {"seed": task.seed, "name": task.name}
    views = read_views_header(task.views)
    # The unit is compared too: the same file in another unit is another object.
    config |= {} if views.unit == "m" else {"unit": views.unit}
    if not task.force and is_complete(task.out, schema=SCHEMA, version=VERSION, config=config):
        with open_hdf5(task.out) as file:
            labelled = str(file.attrs.get("mesh_hash"))
        if labelled != views.mesh_hash:
            raise OptionsDifferError(
                "are labels of another mesh than the one that the views show",
                where=task.out,
                hint="choose another --out, or add --force to make them anew",
            )
        return None
    mesh = load_mesh(task.mesh, views.unit)
    if mesh.sha256 != views.mesh_hash:
        raise InputError(
            "is not the mesh that its views were rendered from (other contents)",
            where=task.mesh,
            hint="render it again: rgrasp render --meshes MESHES --out VIEWS --force "
            f"--pattern '{task.mesh.name}'",
        )
    seed = task_seed(task.seed, task.name)
    with as_input_error(task.mesh):
        samples = sample_sdf(mesh.vertices, mesh.faces, task.config, seed)
    labels = Labels(samples.points, samples.sdf, task.mesh.name, mesh.sha256)
    write_labels(task.out, labels, seed=task.seed, config=config)
    return LabelSummary(len(samples.points), samples.inside_fraction)
