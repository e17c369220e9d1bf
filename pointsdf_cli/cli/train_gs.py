"""`rgrasp train-gs`: labelled grasps to a success network and a prior."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from pointsdf_cli import choices
from pointsdf_cli.cli import common


def train_gs(
    context: typer.Context,
    grasps: common.Grasps,
    out: Annotated[Path, typer.Option(help="Output checkpoint directory.")],
    encoder: Annotated[
        choices.Encoder,
        typer.Option(
            help="Encoder: geometry (distances of the reconstruction at the grasp), or the "
            "published embeddings pointsdf or voxelcnn."
        ),
    ] = "geometry",
    mode: Annotated[
        choices.Mode,
        typer.Option(
            help="Training of the encoder: fixed, fine-tuned, or scratch (no reconstruction)."
        ),
    ] = "fixed",
    sdf: Annotated[
        Path | None,
        typer.Option(
            help="Reconstruction network to build on.  [default: the bundled pointsdf_real, or "
            "voxelcnn for that encoder]"
        ),
    ] = None,
    robot: common.Robot = None,
    epochs: Annotated[
        int | None, typer.Option(help="Largest number of epochs.  [default: 20 for geometry, 60]")
    ] = None,
    batch_size: Annotated[int | None, typer.Option(help="Batch size in grasps.")] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Peak learning rate.")] = None,
    patience: Annotated[
        int | None,
        typer.Option(help="Number of epochs without improvement after which training stops."),
    ] = None,
    validation: Annotated[
        float | None,
        typer.Option(
            help="Share of the training objects held out for validation (geometry uses folds)."
        ),
    ] = None,
    half: Annotated[bool, typer.Option("--half", help="Store the weights in float16.")] = False,
    cache: common.Cache = None,
    threads: common.Threads = 0,
    resume: common.Resume = False,
    seed: common.Seed = 0,
    jobs: common.Jobs = 0,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Train the network that predicts grasp success, and the prior over grasps.

    Ctrl-C stops cleanly, --resume continues.

    Example: rgrasp train-gs --grasps grasps/ --out gs/
    """
    from pointsdf_cli.io.present import require_artifacts
    from pointsdf_cli.models.checkpoint_kinds import require_reconstructions
    from pointsdf_cli.robot.description import load_robot

    require_artifacts(grasps, "grasps", "rgrasp collect-grasps --meshes DIR --out DIR")
    require_reconstructions([sdf])
    machine = load_robot(robot)

    from pointsdf_cli.cli.signals import stop_requests
    from pointsdf_cli.io import checkpoints
    from pointsdf_cli.io.apart import require_apart, require_outside
    from pointsdf_cli.models.grasp_checkpoint import check_hand
    from pointsdf_cli.training.gs_data import read_grasp_data
    from pointsdf_cli.training.gs_loop import Fitted, SuccessTraining, train_success
    from pointsdf_cli.training.gs_outcome import Checkpointer, resumable_state
    from pointsdf_cli.training.gs_variants import Sources, Variant, prepare, prior_of, split_for
    from pointsdf_cli.training.presets import settings_of

    variant = Variant(encoder, mode)
    given = settings_of(SuccessTraining, context.params)
    config = SuccessTraining(**{"epochs": variant.epochs, **given})
    require_apart([out, cache], [grasps, sdf, robot])
    require_outside(cache, grasps, "--cache")
    checkpoints.require_checkpoint_place(out, replace=resume or force)
    common.take_threads(threads)
    state = resumable_state(out, variant, sdf) if resume else None
    reporter = common.Reporter(quiet, as_json)
    data = read_grasp_data(grasps, machine)
    split = split_for(data, variant, config.validation, seed)
    cache = cache or common.cache_beside(grasps)
    with reporter.progress("evaluating the reconstruction", len(data.names)) as bar:
        sources = Sources(cache, sdf, robot, jobs, bar.advance)
        prepared = prepare(data, split, variant, sources, seed)
    if resume:
        check_hand(prepared.sweep, checkpoints.read_config(out), out)
    elif force:
        checkpoints.forget_train_state(out)
    checkpointer = Checkpointer(
        out, prepared, variant, machine, data, split, config, prior_of(data, machine), half
    )
    reporter.say(f"{variant.title}: {split.describe()}; {data.base_rate:.1%} of all held")

    def on_epoch(fitted: Fitted, now: dict[str, Any]) -> None:
        checkpointer.save_now_and_then(fitted, now)
        reporter.say(fitted.describe())

    with stop_requests() as should_stop:
        fitted = train_success(
            data, split, prepared.learner, config,
            resume=state, on_epoch=on_epoch, should_stop=should_stop,
        )  # fmt: skip
    result = checkpointer.finish(fitted)
    reporter.result({"out": out, "variant": variant.title, **result})
    if not fitted.finished:
        saved = "stopped; the same command with --resume continues"
        lost = "stopped before the first epoch ended: nothing was saved"
        reporter.say(saved if fitted.history else lost)
        raise typer.Exit(should_stop.exit_code)
