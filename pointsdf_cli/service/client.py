"""Client of `rgrasp serve`: requests, and answers equal to the planner's own."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import httpx

from pointsdf_cli.errors import InputError, NoPlanError, RgraspError
from pointsdf_cli.io.clouds import Cloud
from pointsdf_cli.io.trees import tree_of_npz, tree_to_npz
from pointsdf_cli.planning.object_choice import TargetChoice
from pointsdf_cli.planning.plan_request import PlanRequest, PlanResult
from pointsdf_cli.service.address import read_token, server_address
from pointsdf_cli.service.identity import PlannerFiles
from pointsdf_cli.service.results import obstacle_tree, result_of

NPZ = "application/x-npz"
LONGEST = 600.0
"""Seconds to wait for an answer: a plan takes about one, in a full queue minutes."""


def plan_at(url: str, request: PlanRequest, files: PlannerFiles) -> PlanResult:
    """The answer of a server, which must have the same robot and weights.

    Args:
        url: Its address.
        request: Checked.
        files: Expected of the server.

    Raises:
        InputError: The planner refuses the request, or the server has other weights.
        RgraspError: No server answers there, or it is busy or fails.
    """
    tree = request_tree(request) | {"expects": files.identity()}
    answer = result_of(tree_of_npz(ask(url, "/plan", tree_to_npz(tree)), url))
    named = {name: None if path is None else str(path) for name, path in vars(files).items()}
    return replace(answer, options=answer.options | named)


def ask(url: str, path: str, body: bytes) -> bytes:
    """The answer to one body.

    Raises:
        RgraspError: The server's error, with its class and exit code.
    """
    token = read_token()
    headers = {"Content-Type": NPZ, "Accept": NPZ}
    if token:
        headers["Authorization"] = f"Bearer {token}"
    try:
        limits = httpx.Timeout(LONGEST, connect=5.0)
        # A proxy of the environment leads elsewhere than to this machine.
        with httpx.Client(timeout=limits, trust_env=False) as client:
            answer = client.post(server_address(url) + path, content=body, headers=headers)
    except (httpx.HTTPError, OSError, UnicodeError) as error:
        said = str(error) or type(error).__name__
        raise RgraspError(
            f"no answer from the server ({said})",
            where=url,
            hint="start it with `rgrasp serve`, or leave --server out",
        ) from error
    if answer.status_code == 200:
        return answer.content
    raise _error(answer, url)


def request_tree(request: PlanRequest) -> dict[str, Any]:
    """The body of a request."""
    around = request.environment
    named = zip(request.clouds, request.names, strict=True)
    return {
        "clouds": [_cloud_tree(cloud, name) for cloud, name in named],
        **asdict(request.choices),
        "environment": {
            "table": around.table,
            "obstacles": [obstacle_tree(each) for each in around.obstacles],
        },
        "start": request.start,
        "seed": request.seed,
        "segment": request.segment,
        "target": _target(request.target),
        "ignore_others": not request.others,
        "obstacles": request.obstacles,
        "workspace": request.workspace,
        "clean": request.cleaned,
    }


def _cloud_tree(cloud: Cloud, name: str) -> dict[str, Any]:
    image = cloud.image
    same = ("points", "frame", "T_world_camera", "pixels", "mask", "mask_rays", "over_table")
    tree = {"name": name} | {part: getattr(cloud, part) for part in same}
    return tree | ({} if image is None else {"depth": image.depth, "K": image.K})


def _target(target: TargetChoice | None) -> int | list[float] | str | None:
    if target is None:
        return None
    if target.any:
        return "any"
    if target.number is not None:
        return target.number
    if target.pixel is not None:
        return [float(value) for value in target.pixel]
    return None if target.place is None else [float(value) for value in target.place]


def _error(answer: httpx.Response, url: str) -> RgraspError:
    """Error of the server, with its own class."""
    try:
        told = answer.json()["error"]
        kind = {2: InputError, 3: NoPlanError}.get(told["exit_code"], RgraspError)
        known = [key for key in ("where", "allowed", "hint") if told.get(key) is not None]
        return kind(str(told["what"]), **{key: str(told[key]) for key in known})
    except (ValueError, KeyError, TypeError, AttributeError):
        what = f"the server answers with status {answer.status_code}"
        return RgraspError(what, where=url, hint="is it `rgrasp serve` that listens there?")
