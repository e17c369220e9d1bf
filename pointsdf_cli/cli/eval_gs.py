"""`rgrasp eval-gs`: success networks on held-out objects, to Figure 3."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

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
    from pointsdf_cli.io.present import require_present
    from pointsdf_cli.robot.description import load_robot

    common.check_seed(seed)
    require_present(grasps, hint="rgrasp collect-grasps --meshes DIR --out DIR")
    require_present(checkpoints=[*checkpoint, sdf])
    machine = load_robot(robot)

    import numpy as np

    from pointsdf_cli.errors import InputError
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_folder, require_new, write_text_atomic
    from pointsdf_cli.io.idle_processors import idle_processors
    from pointsdf_cli.io.provenance import git_commit
    from pointsdf_cli.io.strict_json import to_json
    from pointsdf_cli.models.registry import use_threads
    from pointsdf_cli.training import gs_baselines
    from pointsdf_cli.training import gs_evaluation as evaluation
    from pointsdf_cli.training.gs_data import read_grasp_data
    from pointsdf_cli.training.gs_variants import Sources, prepare_trained, title_of
    from pointsdf_cli.viz.success_figure import draw_success_figure

    seed = common.check_seed(seed)
    common.check_table_name(out, (".png",))
    require_apart([out, out.with_suffix(".png"), cache], [*checkpoint, grasps, sdf, robot])
    table_path, picture = (require_new(path, force) for path in (out, out.with_suffix(".png")))
    require_folder(out.parent)
    labels = common.labels_of(checkpoint)
    use_threads(threads or idle_processors())
    data = read_grasp_data(grasps, machine)
    held_out = data.held_out[data.object_of]
    rows, known = np.flatnonzero(held_out), np.flatnonzero(~held_out)
    if every:
        rows = known = np.arange(len(data))
    for part, what in ((rows, "held-out objects"), (known, "objects to train on")):
        if len(np.unique(data.label[part])) < 2:
            raise InputError(
                f"the grasps of {what} are not both held and lost",
                where=f"--grasps {grasps}",
                hint="collect more grasps, or of more objects",
            )
    reporter = common.Reporter(quiet, as_json)
    cache = cache or common.cache_beside(grasps)
    methods: list[evaluation.Scored] = []
    prior = None
    with reporter.progress("eval-gs", len(data.names)) as bar:
        sources = Sources(cache, sdf, robot, common.job_count(jobs), bar.advance)
        for path, label in zip(checkpoint, labels, strict=True):
            learner, prior, config = prepare_trained(path, data, sources)
            name = title_of(config)
            if name in [method.name for method in methods]:
                name = f"{name} ({label})"
            methods.append(
                evaluation.scored_network(
                    name,
                    learner.logits(rows),
                    **config["calibration"],
                    threshold=config["validation"]["threshold"],
                )
            )
    assert prior is not None
    baselines = [
        ("always success", gs_baselines.always(data, known)),
        ("prior only", gs_baselines.prior_score(data, prior, machine)),
    ]
    if not every:  # else each grasp would be its own neighbour
        baselines.append(("10 nearest neighbours", gs_baselines.nearest_neighbours(data, known)))
    for name, score in baselines:
        baseline = evaluation.scored_baseline(name, score, data.label[known], score[known])
        methods.append(baseline.at(rows))
    table = {method.name: evaluation.measure(data, rows, method, seed) for method in methods}
    result: dict[str, Any] = {
        "table": table,
        "published_f1": evaluation.PUBLISHED,
        "held_out": evaluation.describe_grasps(data, rows),
        "known": evaluation.describe_grasps(data, known),
        "checkpoints": [str(path) for path in checkpoint],
        "grasps": str(grasps),
        "seed": seed,
        "git_commit": git_commit(),
    }
    write_text_atomic(table_path, to_json(result, indent=1) + "\n")
    draw_success_figure(picture, table, evaluation.PUBLISHED)
    about = result["held_out"]
    lines = [
        f"{about['grasps']} grasps of {about['objects']} {'' if every else 'held-out '}objects, "
        f"{about['base_rate']:.1%} held",
        *evaluation.table_lines(table),
        "",
        f"{table_path}, {picture.name}",
    ]
    reporter.result(result, lines)
