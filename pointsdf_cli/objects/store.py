"""Generated objects as files: one PLY each, made in any order by any number of processes."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.volume import enclosed_volume
from pointsdf_cli.io.atomic import TEMPORARY_MARK, require_folder, write_text_atomic
from pointsdf_cli.io.batch import StageReport, run_stage, shard_of
from pointsdf_cli.io.hdf5 import OptionsDifferError
from pointsdf_cli.io.object_mesh import read_object_about, write_object_mesh
from pointsdf_cli.objects.families import Family, choose_families
from pointsdf_cli.objects.generate import GENERATOR_VERSION, family_of, make_object

MANIFEST = "objects.csv"
MOST_OBJECTS = 10_000_000


@dataclass(frozen=True)
class ObjectTask:
    """Assignment of objects to files."""

    seed: int
    index: int
    families: tuple[str, ...] | None
    path: Path
    force: bool


def check_count(count: int) -> int:
    """Check that `count` objects can be made, and return it.

    Raises:
        InputError: The count is out of range.
    """
    if not 1 <= count <= MOST_OBJECTS:
        raise InputError(f"{count} objects", where="--count", allowed=f"1 to {MOST_OBJECTS}")
    return count


def make_objects(
    out: Path,
    count: int,
    seed: int = 0,
    families: Sequence[str] | None = None,
    jobs: int = 1,
    shard: str | None = None,
    force: bool = False,
    on_result: Callable[[str, dict[str, Any] | None], None] | None = None,
) -> StageReport[dict[str, Any]]:
    """Write objects 0 to `count` − 1 of a seed into `out` as `NNNNN_family.ply`.

    Existing files are kept, so that an interrupted run resumes; `objects.csv`, a row for every
    generated object in the folder, is written last.

    Args:
        out: Output folder, created if missing.
        count: 1 or more.
        seed: Random seed of the series of objects; 0 or more.
        families: Names to choose from; None for all.
        jobs: Number of processes.
        shard: `i/n` makes only every n-th object, from the i-th.
        force: Replace existing files.
        on_result: Called with each name and its description (None for a kept file).

    Returns:
        The report of the stage; `made` holds each new object's description.

    Raises:
        InputError: Count, shard or family is invalid, the folder cannot be written, or it has an
            object of another seed or of another version of the generator.
    """
    check_count(count)
    choices = choose_families(families)
    names = None if families is None else tuple(family.name for family in choices)
    indices = shard_of(range(count), shard)
    out = require_folder(out)
    tasks = []
    for index in indices:
        name = f"{index:05d}_{family_of(seed, index, choices).name}"
        tasks.append((name, ObjectTask(seed, index, names, out / f"{name}.ply", force)))
    _require_one_series(out, seed, choices, {name for name, _ in tasks} if force else None)
    report = run_stage(tasks, make_file, jobs=jobs, folders=[out], on_done=on_result)
    if report.made or report.kept:
        write_manifest(out)
    return report


def make_file(task: ObjectTask) -> dict[str, Any] | None:
    """Make one object and write it; returns its description, or None for an existing file.

    Raises:
        OptionsDifferError: The existing file is of another seed or of another generator.
        InputError: The file cannot be written.
    """
    if task.path.exists() and not task.force and _is_same(task):
        return None
    made = make_object(task.seed, task.index, task.families)
    about = {
        "name": made.name,
        "family": made.family,
        "seed": task.seed,
        "index": task.index,
        "generator_version": GENERATOR_VERSION,
        "extent": [round(float(side), 6) for side in np.ptp(made.vertices, axis=0)],
        "volume": float(f"{enclosed_volume(made.vertices, made.faces):.6g}"),
        "vertices": len(made.vertices),
        "faces": len(made.faces),
        "parameters": made.parameters,
    }
    write_object_mesh(task.path, made.vertices, made.faces, about)
    return about


def write_manifest(folder: Path) -> Path:
    """Write `objects.csv`: a row for every generated object in the folder, sorted by name."""
    paths = [p for p in sorted(folder.glob("*.ply")) if TEMPORARY_MARK not in p.name]
    rows = [about for path in paths if (about := read_object_about(path))]
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    sides = ["extent_x_m", "extent_y_m", "extent_z_m"]
    table.writerow(["name", "family", "seed", "index", *sides, "volume_m3", "faces", "parameters"])
    for about in rows:
        which = [about[key] for key in ("name", "family", "seed", "index")]
        drawn = json.dumps(about["parameters"], sort_keys=True)
        table.writerow([*which, *about["extent"], about["volume"], about["faces"], drawn])
    path = folder / MANIFEST
    write_text_atomic(path, text.getvalue())
    return path


def _require_one_series(
    folder: Path, seed: int, choices: Sequence[Family], replaced: Set[str] | None
) -> None:
    """Refuse to mix objects of two seeds in one folder; with `replaced`, remove instead those with
    the numbers of these names, and leave the others.

    Raises:
        OptionsDifferError: The folder has an object that this seed and these families do not make.
    """
    for other in sorted(folder.glob("*.ply")):
        number = other.stem.partition("_")[0]
        if not number.isdecimal():
            continue
        ours = f"{number}_{family_of(seed, int(number), choices).name}"
        about = read_object_about(other) if other.stem != ours else None
        if about is None:
            continue
        if replaced is None:
            what = f"has the number of {ours}, but is of another seed or other families"
            raise OptionsDifferError.of_file(other, f"{what} (seed {about.get('seed')})")
        if ours in replaced:
            other.unlink(missing_ok=True)


def _is_same(task: ObjectTask) -> bool:
    """Whether an existing file is this object; False without a file."""
    about = read_object_about(task.path)
    if about is None:
        raise OptionsDifferError.of_file(task.path, "is not a complete generated object")
    ours = {"seed": task.seed, "index": task.index, "generator_version": GENERATOR_VERSION}
    differing = [key for key in ours if about.get(key) != ours[key]]
    if differing:
        told = ", ".join(f"{key}: {about.get(key)} there, {ours[key]} now" for key in differing)
        raise OptionsDifferError.of_file(task.path, f"was made with other options ({told})")
    return True
