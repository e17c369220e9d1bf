"""`rgrasp view`: artifacts in three dimensions, in a browser or as one HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError


def view(
    artifacts: Annotated[
        list[Path],
        typer.Argument(
            help="Clouds, meshes, and files of render, label-sdf, collect-grasps and plan; "
            "several are shown in one world.",
            metavar="ARTIFACT...",
        ),
    ],
    export: Annotated[
        Path | None,
        typer.Option(metavar="PAGE.html", help="Write one HTML file instead of serving."),
    ] = None,
    robot: common.RobotOfFile = None,
    meshes: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the meshes that artifacts name.  [default: theirs, or ../meshes]"
        ),
    ] = None,
    most: Annotated[
        int, typer.Option(help="Number of views or attempts to show, spread over all.")
    ] = 200,
    unit: common.Unit = "m",
    port: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=65535,
            help="Port to serve at; the next free one if it is taken.  [default: 8080]",
        ),
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(
            help="Address to serve at; 0.0.0.0 lets other machines connect.  [default: 127.0.0.1]"
        ),
    ] = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Look at artifacts in 3D: serve them to a browser, or --export a page that works offline.

    Example: rgrasp view plan.h5 cloud.ply
    """
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_place, write_text_atomic
    from pointsdf_cli.io.present import require_present
    from pointsdf_cli.robot.description import load_robot
    from pointsdf_cli.viz.scene_sources import SceneOptions, kind_of

    reporter = common.Reporter(quiet, as_json)
    for path in artifacts:
        kind_of(path)
    require_present(meshes)
    given = None if robot is None else load_robot(robot)
    options = SceneOptions(given, meshes, most, unit)
    if export:
        if port or host:
            raise InputError("--port or --host with --export", hint="a page needs no server")
        require_apart([export], [*artifacts, robot, meshes])
        common.check_suffix(export, "--export", (".html", ".htm"))
        require_place(export, force)

    # Seconds of imports: only for what can be shown.
    from pointsdf_cli.viz.artifact_scene import scenes_of
    from pointsdf_cli.viz.html_scene import scene_page

    scene = scenes_of(artifacts, options)
    reporter.say(*(f"warning: {value}" for name, value in scene.facts if name == "warning"))
    facts = {"title": scene.title, "frames": scene.frames, "parts": len(scene.parts)}
    if export:
        write_text_atomic(export, scene_page(scene))
        size = export.stat().st_size
        frames = f"{scene.frames} frames, " if scene.frames > 1 else ""
        line = f"{export}: {frames}{size / 1e6:.1f} MB; open it in any browser"
        reporter.result({"written": export, "bytes": size, **facts}, [line])
        return
    from pointsdf_cli.viz.viewer import Viewer

    host = host or "127.0.0.1"
    with Viewer(scene, host, port or 8080) as viewer:
        reporter.result({"url": url(host, viewer.port), **facts}, address(host, viewer.port))
        try:
            viewer.run()
        except KeyboardInterrupt:
            reporter.say("closed")


def url(host: str, port: int) -> str:
    """Address of the page for a browser on this machine."""
    named = "localhost" if host in ("0.0.0.0", "127.0.0.1", "::") else host
    return f"http://[{named}]:{port}" if ":" in named else f"http://{named}:{port}"


def address(host: str, port: int) -> list[str]:
    """Address to open, and the command to type first if this machine is reached by SSH."""
    import os
    import socket

    lines = [f"open {url(host, port)} (Ctrl-C ends)"]
    if os.environ.get("SSH_CONNECTION"):
        name = socket.gethostname()
        lines += [
            "you are here by SSH: type this on your own machine first, then open the same address",
            f"  ssh -L {port}:localhost:{port} {os.environ.get('USER', 'you')}@{name}",
        ]
    return lines
