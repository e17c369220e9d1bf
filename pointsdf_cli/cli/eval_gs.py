"""`rgrasp eval-gs`: success networks on held-out objects, to Figure 3."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pointsdf_cli.cli import common


def eval_gs(
    checkpoint: Annotated[
        list[Path],
        typer.Option(help="Checkpoint of train-gs; may be repeated, one row of the table each."),
    ],
    grasps: common.Grasps,
    out: Annotated[
        Path, typer.Option(help="Output table; a .png of the same name is written beside it.")
    ] = Path("table.json"),
    sdf: Annotated[
        Path | None,
        typer.Option(help="New path of the frozen reconstruction network, if it has moved."),
    ] = None,
    robot: common.Robot = None,
    cache: common.Cache = None,
    every: Annotated[
        bool,
        typer.Option(
            "--all",
            help="Score the grasps of all objects instead of the held-out ones, for data that "
            "no network was trained on.",
        ),
    ] = False,
    threads: common.Threads = 0,
    seed: common.Seed = 0,
    jobs: common.Jobs = 0,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Score success networks beside trivial baselines, with 95% intervals over objects.

    Example: rgrasp eval-gs --checkpoint gs/ --grasps grasps/ --out figure3.json
    """
    from pointsdf_cli.io.present import require_artifacts
    from pointsdf_cli.models.checkpoint_kinds import require_reconstructions, require_successes
    from pointsdf_cli.robot.description import load_robot

    machine = load_robot(robot)
    require_artifacts(grasps, "grasps", "rgrasp collect-grasps --meshes DIR --out DIR")
    require_successes(checkpoint, machine)
    require_reconstructions([sdf])

    from pointsdf_cli.io.apart import require_apart, require_outside
    from pointsdf_cli.io.atomic import write_text_atomic
    from pointsdf_cli.io.strict_json import to_json
    from pointsdf_cli.training import gs_evaluation as evaluation
    from pointsdf_cli.training.gs_data import read_grasp_data
    from pointsdf_cli.training.gs_table import compare
    from pointsdf_cli.training.gs_variants import Sources
    from pointsdf_cli.viz.success_figure import draw_success_figure

    inputs = [*checkpoint, grasps, sdf, robot]
    table_path, picture = common.table_files(out, (".png",), inputs, force)
    require_apart([cache], inputs)
    require_outside(cache, grasps, "--cache")
    labelled = dict(zip(common.labels_of(checkpoint), checkpoint, strict=True))
    common.take_threads(threads)
    data = read_grasp_data(grasps, machine)
    reporter = common.Reporter(quiet, as_json)
    cache = cache or common.cache_beside(grasps)
    with reporter.progress("eval-gs", len(data.names)) as bar:
        sources = Sources(cache, sdf, robot, jobs, bar.advance)
        result = compare(labelled, data, sources, grasps, every, seed)
    write_text_atomic(table_path, to_json(result, indent=1) + "\n")
    draw_success_figure(picture, result["table"], evaluation.PUBLISHED)
    about = result["held_out"]
    count = len(result["left_out"])
    left_out = [f"not scored: {count} objects that a network learned from"] if count else []
    lines = [
        f"{about['grasps']} grasps of {about['objects']} {'' if every else 'held-out '}objects, "
        f"{about['base_rate']:.1%} held",
        *left_out,
        *evaluation.table_lines(result["table"]),
        "",
        f"{table_path}, {picture.name}",
    ]
    reporter.result(result, lines)
