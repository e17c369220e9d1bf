"""`rgrasp train-sdf`: views and labels to the weights of a reconstruction network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from pointsdf_cli import choices
from pointsdf_cli.cli import common


def train_sdf(
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
        typer.Option(help="Loss: distance below which errors count in full (network units)."),
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
    from pointsdf_cli.errors import InputError
    from pointsdf_cli.io.present import require_present

    common.check_seed(seed)
    common.check_device(device)
    if not 0.0 < held_out < 1.0:
        raise InputError(f"{held_out} is no share", where="--held-out", allowed="between 0 and 1")
    require_present(views, hint="rgrasp render --meshes DIR --out DIR")
    require_present(labels, hint="rgrasp label-sdf --views DIR --meshes DIR --out DIR")
    require_present(checkpoints=[start_from])

    # Seconds of imports: only for what can be used.
    from dataclasses import replace

    from pointsdf_cli.cli.signals import stop_requests
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.checkpoints import (
        forget_train_state,
        require_checkpoint_place,
        require_no_run,
    )
    from pointsdf_cli.io.idle_processors import idle_processors
    from pointsdf_cli.io.provenance import git_commit
    from pointsdf_cli.models.registry import build_model, load_model, use_threads
    from pointsdf_cli.training import sdf_loop
    from pointsdf_cli.training.distributed import join_workers
    from pointsdf_cli.training.presets import paper_steps
    from pointsdf_cli.training.presets import preset as settings
    from pointsdf_cli.training.sdf_data import held_out_names, split_views
    from pointsdf_cli.training.sdf_pack import open_pack, pair_artifacts
    from pointsdf_cli.viz.loss_curve import draw_loss_curve

    arguments, config = settings(model, preset)
    chosen: dict[str, Any] = {
        "steps": 10_000_000 if steps is None and minutes else steps,
        "minutes": minutes,
        "batch_size": batch_size,
        "queries": queries,
        "learning_rate": learning_rate,
        "validate_every": validate_every,
        "precision": precision,
    }
    config = replace(config, seed=seed, **{k: v for k, v in chosen.items() if v is not None})
    shape_of_loss = {"near": near, "sign_weight": sign_weight, "temperature": temperature}
    shape_of_loss["quantile"] = quantile
    changes: dict[str, Any] = {k: v for k, v in shape_of_loss.items() if v is not None}
    config = replace(config, loss=replace(config.loss, **changes))
    common.torch_device(device)
    require_apart([out, pack], [views, labels, start_from])
    require_checkpoint_place(out)
    if not resume and not force:
        require_no_run(out)
    with join_workers(device) as (workers, device):
        reporter = common.Reporter(quiet or not workers.is_first, as_json)
        use_threads(threads or max(1, idle_processors() // workers.local_count))
        pairs = pair_artifacts(views, labels)
        limits = _limits(views_per_object or [])
        folder = pack or out.with_name(out.name + "-pack")
        if not workers.is_first:
            workers.wait()
        with reporter.progress("packing", len(pairs)) as bar:
            data = open_pack(pairs, folder, limits, lambda n, _: bar.advance(""), views)
        if workers.is_first:
            workers.wait()
        started = _started_from(start_from, out if resume else None)
        if started is not None and started.get("architecture") != model:
            raise InputError(
                f"is a {started.get('architecture')}",
                where=f"--start-from {start_from}",
                allowed=model,
            )
        before = (started or {}).get("data", {}).get("held_out") or ()
        known = set(before) & set(data.names)
        split = split_views(data, held_out, seed, known)
        if preset == "paper" and steps is None and minutes is None:
            config = replace(config, steps=paper_steps(len(split.train), config.batch_size))
        arguments = {**(started or {}).get("model", {}), **arguments}
        network = build_model(model, arguments, seed=seed)
        if start_from is not None and not resume:
            try:
                network.begin_with(load_model(start_from))
            except RuntimeError as error:
                raise InputError(
                    f"has other sizes than {model} --preset {preset}",
                    where=f"--start-from {start_from}",
                ) from error
            if not known:
                reporter.say(
                    f"{start_from} names no held-out object of {views}: it may have been trained "
                    "on those that are held out here"
                )
            elif len(known) < round(held_out * len(data.names)):
                reporter.say(
                    f"{len(known)} objects are held out, the same as for {start_from}; --held-out "
                    "is not used"
                )
        reporter.say(
            f"{model} with {sum(p.numel() for p in network.parameters()) / 1e6:.1f} M weights; "
            f"{len(data.names)} objects, {len(split.train)} views to train on, "
            f"{len(split.held_out_objects)} of held-out objects"
        )
        if force and not resume and workers.is_first:
            forget_train_state(out)
        with stop_requests() as should_stop:
            result = sdf_loop.train_sdf(
                data,
                split,
                network,
                config,
                out,
                provenance={
                    "preset": preset,
                    "started_from": started,
                    "data": {
                        "objects": len(data.names),
                        "views": len(data.scale),
                        # None where a run before this one may have learned from them.
                        "held_out": None
                        if started is not None and not known
                        else sorted({*held_out_names(data, split), *before}),
                    },
                    "git_commit": git_commit(),
                },
                resume=resume,
                device=device,
                workers=workers,
                on_progress=lambda progress: reporter.say(_line(progress)),
                should_stop=should_stop,
                report_every=10.0,
            )
        if not workers.is_first:
            if not result.finished:
                raise typer.Exit(should_stop.exit_code or ELSEWHERE)
            return
        if result.history:
            draw_loss_curve(result.history, out / "loss.png")
        reporter.result(
            {
                "out": out,
                "finished": result.finished,
                "steps": result.step,
                "seconds": round(result.seconds, 1),
                "best": result.best,
            }
        )
        if not result.finished:
            reporter.say(f"stopped; the same command with --resume continues at step {result.step}")
            raise typer.Exit(should_stop.exit_code or ELSEWHERE)


ELSEWHERE = 143
"""Exit code of a process that stopped because another one of its run was told to."""


def _started_from(start_from: Path | None, resumed: Path | None) -> dict[str, Any] | None:
    """config.json of the checkpoint with the run's initial weights.

    Raises:
        InputError: The resumed run began with another one.
    """
    from pointsdf_cli.errors import InputError
    from pointsdf_cli.io.checkpoints import has_train_state, read_config

    given = None if start_from is None else read_config(start_from)
    if resumed is None or not has_train_state(resumed):
        return given
    begun = read_config(resumed).get("started_from")
    if given is not None and given != begun:
        raise InputError(
            "the run to resume did not begin with that checkpoint as it is now",
            where=f"--start-from {start_from}",
            hint="leave --start-from out: --resume needs none",
        )
    return begun if begun is None else dict(begun)


def _limits(entries: list[str]) -> dict[str, int]:
    from pointsdf_cli.errors import InputError

    limits = {}
    for entry in entries:
        folder, _, number = entry.rpartition("=")
        if not number.isdecimal() or int(number) < 1:
            raise InputError(
                f"{entry!r} is no number of views",
                where="--views-per-object",
                allowed="N, FOLDER=N",
            )
        limits[folder] = int(number)
    return limits


def _line(progress: object) -> str:
    from pointsdf_cli.training.sdf_progress import Progress

    assert isinstance(progress, Progress)
    if progress.validation is not None:
        found = progress.validation
        return (
            f"step {progress.step}: held-out objects loss {found['object_loss']:.4f} "
            f"IoU {found['object_iou']:.4f}, held-out views loss {found['view_loss']:.4f} "
            f"IoU {found['view_iou']:.4f}"
        )
    return (
        f"step {progress.step} ({progress.fraction:.1%}): loss {progress.loss:.4f}, "
        f"{progress.clouds_per_second:.0f} clouds/s, {progress.seconds_left / 60:.0f} min left"
    )
