"""`rgrasp serve`: a planner that stays loaded and answers over HTTP."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Annotated

import typer

from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError, RgraspError


def serve(
    host: Annotated[
        str,
        typer.Option(help="Address to listen at; all but 127.0.0.1 need a token in RGRASP_TOKEN."),
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to listen at; 0 takes a free one.")] = 8765,
    queue: Annotated[
        int, typer.Option(help="Number of requests that may wait; more get status 429.")
    ] = 8,
    largest_body: Annotated[int, typer.Option(help="Largest body of a request [MiB].")] = 64,
    robot: common.Robot = None,
    checkpoint: common.Checkpoint = None,
    grasp_checkpoint: common.GraspCheckpoint = None,
    threads: common.Threads = 0,
    device: common.Device = "cpu",
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Keep networks and robot loaded, and serve plans, meshes and success scores over HTTP.

    Paths: /plan, /mesh, /score and /health; /docs describes them. SIGTERM and Ctrl-C let the
    running request finish.

    Example: rgrasp serve --port 8765
    """
    from pointsdf_cli.models.checkpoint_kinds import require_reconstructions, require_successes
    from pointsdf_cli.robot.description import load_robot
    from pointsdf_cli.service.address import LOOPBACK, TOKEN, read_token

    reporter = common.Reporter(quiet, as_json)
    token = read_token()
    for option, value, low, high in (
        ("--port", port, 0, 65535), ("--queue", queue, 0, 1000),
        ("--largest-body", largest_body, 1, 4096),
    ):  # fmt: skip
        if not low <= value <= high:
            raise InputError(f"{value}", where=option, allowed=f"{low} to {high}")
    if host not in LOOPBACK and token is None:
        raise InputError(
            "other machines could connect, and no token is set",
            where=f"--host {host}",
            allowed="127.0.0.1, or any address with a token",
            hint=f"export {TOKEN}=$(openssl rand -hex 16), for the server and its clients",
        )
    require_reconstructions([checkpoint])
    require_successes([grasp_checkpoint], load_robot(robot))
    try:
        for library in ("fastapi", "fastapi_offline", "uvicorn"):
            import_module(library)
    except ImportError as error:
        raise RgraspError(
            f"the server needs FastAPI and uvicorn, and {error.name} is not installed",
            hint="in rgrasp's folder: pip install -c constraints.txt '.[serve]'",
        ) from error

    # Seconds of imports: only for options that can be used.
    from pointsdf_cli.cli.signals import stop_requests
    from pointsdf_cli.planning.plan_request import PlanChoices
    from pointsdf_cli.service.identity import PlannerFiles
    from pointsdf_cli.service.resident import Resident
    from pointsdf_cli.service.server import Server

    files = PlannerFiles(robot, checkpoint, grasp_checkpoint)
    resident = Resident(files, common.torch_device(device))
    common.take_threads(threads)
    resident.identity()  # of the files that are loaded now
    resident.planner(PlanChoices())
    with stop_requests() as stopped:
        server = Server(resident, host, port, token, queue, largest_body << 20)
        with server:
            # A browser sends no token.
            docs = f"; {server.url}/docs" if token is None else ""
            reporter.result({"url": server.url}, [f"{server.url}: ready{docs}"])
            sys.stdout.flush()  # scripts wait for this line
            server.wait(stopped)
            reporter.say("stopping after the running request")
