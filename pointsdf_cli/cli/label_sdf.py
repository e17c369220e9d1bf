"""`rgrasp label-sdf`: meshes to points with signed distances."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pointsdf_cli.cli import common


def label_sdf(
    views: common.Views,
    meshes: Annotated[Path, typer.Option(help="Folder of the rendered meshes.")],
    out: Annotated[Path, typer.Option(help="Output folder: one HDF5 of labelled points per mesh.")],
    points: Annotated[int, typer.Option(help="Number of labelled points per mesh.")] = 50_000,
    pattern: common.Pattern = "*",
    seed: common.Seed = 0,
    jobs: common.Jobs = 0,
    shard: common.Shard = None,
    force: common.Force = False,
    skip_bad: common.SkipBad = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Label points around every rendered mesh with exact signed distances.

    Example: rgrasp label-sdf --views views/ --meshes ycb/ --out labels/
    """
    from pointsdf_cli.geometry.sdf_sampling import SamplingConfig
    from pointsdf_cli.io.apart import require_apart, require_outside
    from pointsdf_cli.io.atomic import require_folder
    from pointsdf_cli.io.batch import shard_of
    from pointsdf_cli.objects.labelling import find_label_tasks, label_file

    config = SamplingConfig(points)
    require_outside(out, views, "--out")
    tasks = find_label_tasks(views, meshes, out, config, seed, force, pattern)
    found = shard_of(tasks, shard)
    require_apart((t.out for t in found), [path for t in found for path in (t.views, t.mesh)])
    out = require_folder(out)
    reporter = common.Reporter(quiet, as_json)
    named, folders = [(task.name, task) for task in found], (task.out.parent for task in found)
    report = reporter.stage("label-sdf", named, label_file, jobs, folders)
    made = list(report.made.values())
    labelled = sum(summary.points for summary in made)
    inside = sum(s.inside_fraction * s.points for s in made) / labelled if labelled else 0.0
    rate = labelled / report.seconds if report.seconds else 0.0
    by_mesh = {name: summary.inside_fraction for name, summary in report.made.items()}
    values = {
        "points": labelled,
        "inside_fraction": inside,
        "points_per_second": rate,
        "inside_fraction_by_mesh": by_mesh,
    }
    line = f"{labelled} points, {inside:.1%} inside, {rate:.0f} a second"
    reporter.finish(report, out, skip_bad, values, [line])
