"""The table of commands. Each lives in a file of its own and imports what it needs when it runs."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from pointsdf_cli import __version__
from pointsdf_cli.cli import (
    calibrate,
    cloud,
    collect_grasps,
    doctor,
    eval_gs,
    eval_sdf,
    info,
    label_sdf,
    mesh,
    objects,
    plan,
    render,
    report,
    robot,
    segment,
    serve,
    train_gs,
    train_sdf,
    trial,
    view,
)
from pointsdf_cli.errors import InputError


class _Commands(TyperGroup):
    """Commands that tell a wrong choice like any other bad input."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command.

        Raises:
            InputError: An option has a fixed set of values, and another one was given.
        """
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            option, inner = error.param, error.ctx
            if option is None or inner is None:
                raise
            # What completion offers is known to every version of Typer in the same way.
            offered = [item.value for item in option.shell_complete(inner, "") if item.value]
            if not offered:
                raise
            name, value = option.opts[0], error.message.partition(" is not one of ")[0]
            raise InputError(
                f"no {name.lstrip('-').replace('-', ' ')} {value.removeprefix('Value error, ')}",
                where=name if name.startswith("-") else name.upper(),
                allowed=", ".join(offered),
            ) from error


app = typer.Typer(
    name="rgrasp",
    cls=_Commands,
    help="Grasp planning for unknown objects from one partial point cloud.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"rgrasp {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
    largest_input: Annotated[
        str | None,
        typer.Option(metavar="SIZE", help="Read input files up to this size, such as 20G."),
    ] = None,
) -> None:
    if largest_input is not None:
        from pointsdf_cli.io.input_files import allow_inputs_of

        allow_inputs_of(largest_input)


app.add_typer(objects.app, name="objects")
app.command("render")(render.render)
app.command("label-sdf")(label_sdf.label_sdf)
app.command("train-sdf")(train_sdf.train_sdf)
app.command("eval-sdf")(eval_sdf.eval_sdf)
app.command("calibrate")(calibrate.calibrate)
app.command("cloud")(cloud.cloud)
app.command("segment")(segment.segment)
app.command("mesh")(mesh.mesh)
app.command("collect-grasps")(collect_grasps.collect_grasps)
app.command("train-gs")(train_gs.train_gs)
app.command("eval-gs")(eval_gs.eval_gs)
app.command("plan")(plan.plan)
app.command("serve")(serve.serve)
app.command("trial")(trial.trial)
app.command("info")(info.info)
app.command("doctor")(doctor.doctor)
app.command("report")(report.report)
app.add_typer(robot.app, name="robot")
app.command("view")(view.view)
