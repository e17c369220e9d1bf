"""The table of commands. Each lives in a file of its own and imports what it needs when it runs."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from pointsdf_cli import __version__
from pointsdf_cli.errors import InputError

COMMANDS = (
    *("objects", "render", "label-sdf", "train-sdf", "eval-sdf"),
    *("calibrate", "cloud", "segment", "mesh"),
    *("collect-grasps", "train-gs", "eval-gs", "plan", "serve", "trial"),
    *("info", "doctor", "report", "robot", "view"),
)
"""Commands in the order of the help. Each is defined in the module of its name: as a function of
that name or, if it has subcommands, as `app`."""


class _Commands(TyperGroup):
    """Command group that reports an invalid choice as any other bad input."""

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
            # The values offered for completion are available in the same way in all Typer versions.
            offered = [item.value for item in option.shell_complete(inner, "") if item.value]
            if not offered:
                raise
            name, value = option.opts[0], error.message.partition(" is not one of ")[0]
            raise InputError(
                f"no {name.lstrip('-').replace('-', ' ')} {value.removeprefix('Value error, ')}",
                where=name if name.startswith("-") else name.upper(),
                allowed=", ".join(offered),
            ) from error


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"rgrasp {__version__}")
        raise typer.Exit


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


def app_of(arguments: Sequence[str] = ()) -> typer.Typer:
    """The program with the commands named in `arguments`, or with all if none is named: importing
    all takes longer than reporting most mistakes."""
    app = typer.Typer(
        name="rgrasp",
        cls=_Commands,
        help="Grasp planning for unknown objects from one partial point cloud.",
        no_args_is_help=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    for name in [name for name in COMMANDS if name in arguments] or COMMANDS:
        place = name.replace("-", "_")
        module = import_module(f"pointsdf_cli.cli.{place}")
        if hasattr(module, "app"):
            app.add_typer(module.app, name=name)
        else:
            app.command(name)(getattr(module, place))
    return app
