"""`rgrasp train-sdf`: views and labels to the weights of a reconstruction network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pointsdf_cli import choices
from pointsdf_cli.cli import common


def train_sdf(
    context: typer.Context,
    views: common.Views,
    labels: Annotated[Path, typer.Option(help="Folder of labels made by `rgrasp label-sdf`.")],
    out: Annotated[Path, typer.Option(help="Output checkpoint directory.")],
    model: Annotated[choices.Model, typer.Option(help="Architecture.")] = "pointsdf-ray",
    preset: Annotated[
        choices.Preset, typer.Option(help="Preset; paper is the published recipe.")
    ] = "small",
    steps: Annotated[
        int | None,
        typer.Option(
            help="Number of optimiser steps [default: 20000; with --preset paper 100 epochs]."
        ),
    ] = None,
    minutes: Annotated[
        float | None,
        typer.Option(help="Training time instead of --steps; the schedule follows the clock."),
    ] = None,
    batch_size: Annotated[int | None, typer.Option(help="Batch size in clouds.")] = None,
    queries: Annotated[
        int | None, typer.Option(help="Number of labelled points per cloud.")
    ] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Peak learning rate.")] = None,
    near: Annotated[
        float | None,
        typer.Option(help="Loss: distance above which errors are relative (network units)."),
    ] = None,
    sign_weight: Annotated[float | None, typer.Option(help="Loss: weight of the sign.")] = None,
    temperature: Annotated[
        float | None,
        typer.Option(help="Loss: distance at which a sign counts as certain (network units)."),
    ] = None,
    quantile: Annotated[
        float | None,
        typer.Option(help="Loss: probability of being inside at the predicted surface."),
    ] = None,
    overlap_weight: Annotated[
        float | None, typer.Option(help="Loss: weight of 1 − IoU of predicted and true interior.")
    ] = None,
    start_from: Annotated[
        Path | None, typer.Option(help="Checkpoint with the initial weights.")
    ] = None,
    held_out: Annotated[
        float, typer.Option(help="Share of the objects held out for validation.")
    ] = 0.05,
    views_per_object: Annotated[
        list[str] | None,
        typer.Option(
            metavar="N|FOLDER=N", help="Largest number of views per object; may be repeated."
        ),
    ] = None,
    validate_every: Annotated[
        int | None, typer.Option(help="Number of steps between validations.")
    ] = None,
    precision: Annotated[
        choices.Precision | None,
        typer.Option(help="Precision  [default: auto; with --preset paper float32]."),
    ] = None,
    pack: Annotated[
        Path | None, typer.Option(help="Folder of the packed data [default: OUT-pack].")
    ] = None,
    threads: common.Threads = 0,
    resume: common.Resume = False,
    seed: common.Seed = 0,
    device: common.Device = "cpu",
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Train a network that completes partial clouds; Ctrl-C stops cleanly, --resume continues.

    Example: rgrasp train-sdf --views views/ --labels labels/ --out ckpt/ --minutes 60
    """
    from pointsdf_cli.io.present import require_artifacts
    from pointsdf_cli.models.checkpoint_kinds import require_reconstructions
    from pointsdf_cli.training.presets import settings

    settings(model, preset, context.params)  # a mistake is told before the data are read
    require_artifacts(views, "views", "rgrasp render --meshes DIR --out DIR")
    require_artifacts(labels, "labels", "rgrasp label-sdf --views DIR --meshes DIR --out DIR")
    require_reconstructions([start_from])

    # Seconds of imports: only for what can be used.
    from pointsdf_cli.cli.signals import stop_requests
    from pointsdf_cli.io import checkpoints
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.idle_processors import idle_processors
    from pointsdf_cli.models.registry import use_threads
    from pointsdf_cli.training import sdf_loop
    from pointsdf_cli.training.distributed import join_workers
    from pointsdf_cli.training.sdf_pack import open_pack, pair_artifacts
    from pointsdf_cli.training.sdf_run import SdfRun, view_limits
    from pointsdf_cli.viz.loss_curve import draw_loss_curve

    common.torch_device(device)
    require_apart([out, pack], [views, labels, start_from])
    checkpoints.require_checkpoint_place(out, replace=resume or force)
    run = SdfRun(views, out, model, preset, start_from, held_out, resume)
    run.started_from()
    if resume:
        checkpoints.read_train_state(out)  # packing takes minutes or hours
    with join_workers(device) as (workers, device):
        reporter = common.Reporter(quiet or not workers.is_first, as_json)
        use_threads(threads or max(1, idle_processors() // workers.local_count))
        pairs, limits = pair_artifacts(views, labels), view_limits(views_per_object or [])
        folder = pack or out.with_name(out.name + "-pack")
        with workers.first_before_others(), reporter.progress("packing", len(pairs)) as bar:
            data = open_pack(pairs, folder, limits, lambda n, _: bar.advance(""), views)
        network, split, config, provenance, notes = run.begin(data, context.params)
        reporter.say(*notes)
        if force and not resume and workers.is_first:
            checkpoints.forget_train_state(out)
        with stop_requests() as should_stop:
            result = sdf_loop.train_sdf(
                data, split, network, config, out, provenance=provenance, resume=resume,
                device=device, workers=workers, should_stop=should_stop, report_every=10.0,
                on_progress=lambda progress: reporter.say(progress.describe()),
            )  # fmt: skip
        if workers.is_first:
            if result.history:
                draw_loss_curve(result.history, out / "loss.png")
            reporter.result({"out": out, **result.as_dict()})
        if not result.finished:
            reporter.say(f"stopped; the same command with --resume continues at step {result.step}")
            raise typer.Exit(should_stop.exit_code or ELSEWHERE)


ELSEWHERE = 143
"""Exit code of a process that stopped because another one of its run was told to."""
