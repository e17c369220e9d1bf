"""Clients of `rgrasp serve` that keep it waiting or hang up: nobody else is kept out."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("fastapi", reason="the extra `serve` is not installed")
pytest.importorskip("uvicorn", reason="the extra `serve` is not installed")

import httpx

from pointsdf_cli.service import deadlines
from pointsdf_cli.service import server as service
from pointsdf_cli.service.server import CONNECTIONS, Server

NOBODY: Any = None
"""Nothing here gets as far as a plan."""


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.setattr(deadlines, "SLOWEST_HEAD", 0.5)
    with Server(NOBODY, places=2) as running:
        yield running


def crowd(server: Server, first: bytes) -> list[socket.socket]:
    """All but one of the connections that the server takes, each with these first bytes."""
    lines = [socket.create_connection(("127.0.0.1", server.port)) for _ in range(CONNECTIONS - 1)]
    for line in lines:
        line.sendall(first)
    return lines


def health(server: Server) -> int:
    return httpx.get(server.url + "/health").status_code


def head(server: Server, what: str = "GET /health") -> bytes:
    return f"{what} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n".encode()


@pytest.mark.parametrize("kept", ["nothing", "half a head", "a head after an answer"])
def test_connections_that_ask_nothing_are_closed(server: Server, kept: str) -> None:
    first = {
        "nothing": b"",
        "half a head": head(server, "POST /plan"),
        "a head after an answer": head(server) + b"\r\n" + head(server),
    }[kept]
    lines = crowd(server, first)
    until(lambda: health(server) == 200, "idle connections keep everyone else out")
    for line in lines:
        line.close()


def test_dripping_bytes_win_no_time(server: Server) -> None:
    with socket.create_connection(("127.0.0.1", server.port)) as line:
        line.sendall(head(server))

        def hung_up() -> bool:
            try:
                line.sendall(b"X-A: b\r\n")
            except OSError:
                return True
            return False

        until(hung_up, "bytes that drip keep a connection")


def test_an_ordinary_client_is_not_hurried(server: Server) -> None:
    with httpx.Client() as client:
        for _ in range(4):
            assert client.get(server.url + "/health").status_code == 200
            time.sleep(0.3)


def test_an_answer_that_nobody_reads_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    async def much(scope: Any, receive: Any, send: Any) -> None:
        """More than the system's buffers take."""
        if scope["type"] == "http":
            await send({"type": "http.response.start", "status": 200, "headers": []})
            await send({"type": "http.response.body", "body": bytes(64 << 20)})

    monkeypatch.setattr(deadlines, "SLOWEST_READER", 0.3)
    monkeypatch.setattr(service, "make_app", lambda *_: much)
    with Server(NOBODY) as server, socket.create_connection(("127.0.0.1", server.port)) as line:
        line.sendall(head(server) + b"\r\n")
        held = server._server.server_state.connections
        until(lambda: bool(held), "no connection")
        until(lambda: not held, "a connection is held by who does not read")


def until(holds: Callable[[], bool], otherwise: str) -> None:
    end = time.monotonic() + 15
    while not holds():
        assert time.monotonic() < end, otherwise
        time.sleep(0.02)


def test_who_hangs_up_while_sending_is_no_error_of_the_server(
    server: Server, caplog: pytest.LogCaptureFixture
) -> None:
    with socket.create_connection(("127.0.0.1", server.port)) as line:
        line.sendall(head(server, "POST /plan") + b"Content-Length: 1000\r\n\r\n{")
        until(lambda: server.queue.waiting == 1, "no place is taken")
    until(lambda: server.queue.waiting == 0, "its place is kept")
    time.sleep(0.2)
    assert [record for record in caplog.records if record.levelname == "ERROR"] == []
