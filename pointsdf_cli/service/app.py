"""The HTTP interface: /plan, /mesh, /score, /health, and an OpenAPI page at /docs."""

from __future__ import annotations

import asyncio
import hmac
import json
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, TypeVar

from fastapi import FastAPI, Request, Response
from fastapi_offline import FastAPIOffline
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Receive, Scope, Send

from pointsdf_cli import __version__
from pointsdf_cli.errors import EmptyResultError, InputError, RgraspError
from pointsdf_cli.planning.cancellation import CancelledError
from pointsdf_cli.service.answers import mesh_answer, plan_answer, score_answer
from pointsdf_cli.service.bodies import (
    HDF5,
    JSON,
    NPZ,
    AnyBody,
    MeshBody,
    PlanBody,
    ScoreBody,
    read_body,
    schema_of,
)
from pointsdf_cli.service.request_queue import BusyError, ClosingError, RequestQueue
from pointsdf_cli.service.resident import Resident
from pointsdf_cli.viz.viewer_access import may_connect

T = TypeVar("T")

LARGEST_BODY = 64 << 20
"""Largest body in bytes: a depth image of two million pixels with its further fields."""

SLOWEST_BODY = 60.0
"""Time limit for receiving a body [s]; it holds a place in the queue meanwhile."""

Answer = tuple[bytes, str]
DESCRIPTION = (
    "Grasps of objects that nobody has modelled. Lengths in metres, angles in radians. Answers are "
    "JSON, or with `Accept: application/x-npz` arrays; of /plan also `application/x-hdf5`, the "
    "file that `rgrasp plan` writes."
)
"""The server, as its OpenAPI page describes it."""


class TooLargeError(InputError):
    """A body beyond the limit."""


def make_app(
    resident: Resident,
    queue: RequestQueue,
    host: str = "127.0.0.1",
    token: str | None = None,
    largest: int = LARGEST_BODY,
) -> FastAPI:
    """The application.

    Args:
        resident: Answers.
        queue: Queue and worker, one request after the other.
        host: Address that the server listens on: determines the allowed page origins.
        token: Secret that requests must bear in `Authorization: Bearer`; None for none.
        largest: Bytes of a body.
    """
    app = FastAPIOffline(  # robots' machines rarely reach the internet
        title="rgrasp",
        version=__version__,
        description=DESCRIPTION,
        redoc_url=None,
    )
    app.add_middleware(Gate, host=host, token=token)
    app.add_exception_handler(Exception, _unexpected)

    @app.get("/health")
    async def health() -> dict[str, Any]:
        """Whether the server answers, and how many requests have a place."""
        told = {"status": "ok", "version": __version__}
        return {**told, "waiting": queue.waiting, "done": queue.done}

    parts: dict[str, Any] = {}

    def offer(
        path: str, kind: type[AnyBody], answer: Callable[[Resident, AnyBody, str], Answer]
    ) -> None:
        async def ask(request: Request) -> Response:
            def work(data: bytes) -> Callable[[], Answer]:
                body = read_body(kind, data, request.headers.get("content-type", ""))
                body.check()
                return lambda: answer(resident, body, _form(request))

            return await _answered(request, queue, work, largest)

        ask.__doc__ = answer.__doc__
        schema, its_parts = schema_of(kind)
        parts.update(its_parts)
        app.post(path, name=path.strip("/"), openapi_extra=schema)(ask)

    offer("/plan", PlanBody, plan_answer)
    offer("/mesh", MeshBody, mesh_answer)
    offer("/score", ScoreBody, score_answer)
    described = app.openapi

    def openapi() -> dict[str, Any]:
        schema = described()
        schema.setdefault("components", {}).setdefault("schemas", {}).update(parts)
        return schema

    app.openapi = openapi  # type: ignore[method-assign]
    return app


class Gate:
    """Middleware that admits requests with the token, and no page of another origin."""

    def __init__(self, app: ASGIApp, host: str, token: str | None) -> None:
        self._app, self._host, self._token = app, host, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        refused = self._refusal(scope) if scope["type"] == "http" else None
        if refused is None:
            await self._app(scope, receive, send)
        else:
            code, error = refused
            await _error_response(error, code)(scope, receive, send)

    def _refusal(self, scope: Scope) -> tuple[int, RgraspError] | None:
        headers = Headers(scope=scope)
        if self._token is not None:
            given = headers.get("authorization", "").encode("latin-1")
            known = hmac.compare_digest(given, b"Bearer " + self._token.encode())
            if known or scope["path"] == "/health":
                return None
            return 401, InputError(
                "the token is missing or wrong",
                where="Authorization",
                allowed="Bearer TOKEN",
                hint="set RGRASP_TOKEN to the server's token",
            )
        origins, asked = headers.getlist("origin"), headers.get("host", "")
        # Without an Origin header the Host header still reveals DNS rebinding.
        page = origins[0] if origins else f"http://{asked}"
        if len(origins) < 2 and may_connect(page, asked, self._host):
            return None
        return 403, RgraspError("requests from pages of another origin are refused")


async def _answered(
    request: Request,
    queue: RequestQueue,
    work: Callable[[bytes], Callable[[], Answer]],
    largest: int,
) -> Response:
    """The response to one request, which has a place in the queue from its first byte on."""
    try:
        job = queue.take_place()
    except BusyError as error:
        return _error_response(error, 429, {"Retry-After": "2"})
    except ClosingError as error:
        return _error_response(error, 503)
    try:
        try:
            async with asyncio.timeout(SLOWEST_BODY):
                data = await _unless(partial(_stopped, queue), _body(request, largest))
        except TimeoutError:
            return _error_response(RgraspError("the body did not arrive in time"), 408)
        ready = await _unless(request.is_disconnected, asyncio.to_thread(work, data))
        del data
        waiting = asyncio.wrap_future(queue.submit(job, ready))
        while not waiting.done():
            await asyncio.wait({waiting}, timeout=0.05)
            if not waiting.done() and await request.is_disconnected():
                queue.leave(job)
        answer, form = waiting.result()
        return Response(answer, media_type=form)
    except TooLargeError as error:
        return _error_response(error, 413, {"Connection": "close"})
    except CancelledError as error:
        return _error_response(error, 499)
    except ClientDisconnect:
        return _error_response(RgraspError("the client hung up"), 499)
    except ClosingError as error:
        return _error_response(error, 503)
    except InputError as error:
        return _error_response(error, 400)
    except RgraspError as error:
        empty = error.exit_code == 3 or isinstance(error, EmptyResultError)
        return _error_response(error, 422 if empty else 500)
    except MemoryError:
        return _error_response(RgraspError("not enough memory for this request"), 500)
    finally:
        queue.leave(job)


async def _unless(left: Callable[[], Awaitable[bool]], work: Awaitable[T]) -> T:
    """The result of `work`, waited for as long as `left` is false.

    Raises:
        ClientDisconnect: Nobody waits for it any more.
    """
    task = asyncio.ensure_future(work)
    try:
        while not task.done():
            await asyncio.wait({task}, timeout=0.05)
            if not task.done() and await left():
                raise ClientDisconnect
        return task.result()
    finally:
        task.cancel()


async def _stopped(queue: RequestQueue) -> bool:
    """False while the server runs.

    Raises:
        ClosingError: It stops.
    """
    queue.require_open()
    return False


async def _body(request: Request, largest: int) -> bytes:
    """The body of a request.

    Raises:
        TooLargeError: Larger than `largest`.
    """
    length = request.headers.get("content-length", "0")
    parts, size = [], int(length) if length.isdecimal() else 0
    if size <= largest:
        size = 0
        async for part in request.stream():
            size += len(part)
            if size > largest:
                break
            parts.append(part)
    if size > largest:
        raise TooLargeError(
            "the body is too large",
            where="body",
            allowed=f"{largest >> 20} MiB",
            hint="send fewer points, arrays instead of JSON, or start `rgrasp serve` with a larger "
            "--largest-body",
        )
    return b"".join(parts)


async def _unexpected(_: Request, __: Exception) -> Response:
    """Answer to a request that met a defect; its traceback goes to the server's terminal."""
    return _error_response(RgraspError("the server failed; its terminal says why"), 500)


def _form(request: Request) -> str:
    """The type of answer that is wanted."""
    accepted = request.headers.get("accept", "")
    return next((form for form in (NPZ, HDF5) if form in accepted), JSON)


def _error_response(
    error: RgraspError, code: int, headers: dict[str, str] | None = None
) -> Response:
    parts = ("what", "where", "allowed", "hint", "exit_code", "message")
    told = {name: getattr(error, name) for name in parts}
    return Response(json.dumps({"error": told}), code, headers, JSON)
