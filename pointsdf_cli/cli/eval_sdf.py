"""`rgrasp eval-sdf`: trained networks to Table I."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from pointsdf_cli.cli import common


def eval_sdf(
    checkpoint: Annotated[
        list[Path], typer.Option(help="Checkpoint; may be repeated, one row of the table each.")
    ],
    views: common.Views,
    meshes: Annotated[Path, typer.Option(help="Folder of the true meshes.")],
    out: Annotated[
        Path,
        typer.Option(
            help="Output table; a .csv and a .png of the same name are written beside it."
        ),
    ] = Path("table.json"),
    count: Annotated[
        int, typer.Option(min=0, help="Number of views of each object; 0 uses all.")
    ] = 10,
    resolution: Annotated[int, typer.Option(help="Resolution of the scored meshes.")] = 128,
    samples: Annotated[
        int, typer.Option(min=1, help="Number of points for each metric.")
    ] = 100_000,
    exact: Annotated[
        bool,
        typer.Option(
            "--exact", help="Evaluate the networks on the full grid, as in `rgrasp mesh --exact`."
        ),
    ] = False,
    precision: common.Precision = "auto",
    apart: Annotated[
        list[str] | None,
        typer.Option(help="Object to report separately, such as a poor scan; may be repeated."),
    ] = None,
    beside: Annotated[
        Literal["graspdb", "ycb"] | None,
        typer.Option(help="Also print the published rows of this data set."),
    ] = None,
    gallery: Annotated[
        int, typer.Option(min=0, help="Number of best, median and worst views each in the picture.")
    ] = 3,
    pattern: common.Pattern = "*",
    seed: common.Seed = 0,
    jobs: common.Jobs = 0,
    skip_bad: common.SkipBad = False,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Score reconstructions: IoU, Chamfer-L1 and normal consistency, beside trivial baselines.

    Example: rgrasp eval-sdf --checkpoint ckpt/ --views views/ --meshes ycb/ --out table.json
    """
    from pointsdf_cli.geometry.isosurface import IsosurfaceConfig
    from pointsdf_cli.io.meshes import find_meshes
    from pointsdf_cli.io.present import require_artifacts
    from pointsdf_cli.models.checkpoint_kinds import require_reconstructions

    IsosurfaceConfig(resolution)
    require_artifacts(views, "views", f"rgrasp render --meshes {meshes} --out {views}")
    find_meshes(meshes, pattern)
    require_reconstructions(checkpoint)
    table_path, csv_path, picture = common.table_files(
        out, (".csv", ".png"), [*checkpoint, views, meshes], force
    )

    # Seconds of imports: only for what can be used.
    from pointsdf_cli.io.atomic import write_text_atomic
    from pointsdf_cli.io.strict_json import to_json
    from pointsdf_cli.models.registry import load_model
    from pointsdf_cli.training import evaluate_sdf as evaluation
    from pointsdf_cli.training.sdf_table import objects_csv

    for path in checkpoint:
        load_model(path)  # a bad checkpoint is known before the processes start
    labelled = tuple(zip(common.labels_of(checkpoint), checkpoint, strict=True))
    config = evaluation.EvalConfig(labelled, resolution, count, samples, precision, exact, seed)
    aside = sorted({*(apart or [])})
    tasks = evaluation.make_tasks(views, meshes, config, aside, pattern)
    reporter = common.Reporter(quiet, as_json)
    without_mesh = sum(1 for _ in views.rglob("*.h5")) - len(tasks)
    if without_mesh and meshes.is_dir():
        reporter.say(f"{views}: {without_mesh} files without a mesh in {meshes} are not scored")
    named = [(task.name, task) for task in tasks]
    report = reporter.stage("eval-sdf", named, evaluation.evaluate_object, jobs)
    if not report.made:
        report.raise_if_refused()
    result, lines = evaluation.results(report, config, (views, meshes), aside, beside)
    write_text_atomic(table_path, to_json(result, indent=1) + "\n")
    write_text_atomic(csv_path, objects_csv([v for rows in report.made.values() for v in rows]))
    evaluation.draw_extremes(picture, tasks, report, aside, gallery)
    reporter.result(result, [*lines, "", f"{table_path}, {csv_path.name}; {report.seconds:.0f} s"])
    if not skip_bad:  # the table of the others is there by now
        report.raise_if_refused(
            "mend or remove them, or add --skip-bad, and run the same command again with --force"
        )
