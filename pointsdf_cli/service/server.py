"""The server: uvicorn in a thread, until it is asked to stop."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from typing import Any

import uvicorn

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.models.processor import return_freed_memory
from pointsdf_cli.service.app import LARGEST_BODY, make_app
from pointsdf_cli.service.deadlines import PunctualProtocol
from pointsdf_cli.service.request_queue import RequestQueue
from pointsdf_cli.service.resident import Resident

CONNECTIONS = 64
"""Connections at once; each may be sending a body."""

TRIMMED = 20
"""Freed memory is returned to the system after this many requests. Getting it back costs the next
plan 60 ms."""


class Server:
    """Listens within `with`.

    Args:
        resident: Answers.
        host, port: Address to listen at; port 0 takes a free one.
        token: As in `make_app`.
        places: Requests that may wait.
        largest: Bytes of a body.

    Attributes:
        port: Port that it listens at.

    Raises:
        InputError: It cannot listen there.
    """

    def __init__(
        self,
        resident: Resident,
        host: str = "127.0.0.1",
        port: int = 0,
        token: str | None = None,
        places: int = 8,
        largest: int = LARGEST_BODY,
    ) -> None:
        self._socket = _listening(host, port)
        self.host, self.port = host, int(self._socket.getsockname()[1])
        self.queue = RequestQueue(places, self._after_request)
        app: Any = make_app(resident, self.queue, host, token, largest)
        config = uvicorn.Config(
            app,
            http=PunctualProtocol,
            log_level="warning",
            access_log=False,
            limit_concurrency=CONNECTIONS,
            timeout_keep_alive=5,
            ws="none",
            server_header=False,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._socket]}, name="http", daemon=True
        )

    def __enter__(self) -> Server:
        """Listen.

        Raises:
            RgraspError: It ended at once.
        """
        self._thread.start()
        while not self._server.started:
            if not self._thread.is_alive():
                raise RgraspError("the server did not start")
            time.sleep(0.01)
        return self

    def __exit__(self, *_: object) -> None:
        """Finish running work, refuse waiting requests, and end."""
        self.queue.close()
        self._server.should_exit = True
        self._thread.join()
        self.queue.join()
        self._socket.close()

    @property
    def url(self) -> str:
        """Its address."""
        return f"http://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"

    def _after_request(self) -> None:
        if self.queue.done % TRIMMED == 0:
            return_freed_memory()

    def wait(self, stopped: Callable[[], bool]) -> None:
        """Serve until `stopped` or until the server ended by itself."""
        while self._thread.is_alive() and not stopped():
            time.sleep(0.1)


def _listening(host: str, port: int) -> socket.socket:
    try:
        kind, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        # asyncio turns Nagle's algorithm off only if the protocol is named: without, the body of
        # an answer would wait 40 ms for the client to acknowledge its head.
        bound = socket.socket(kind, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        try:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.bind(address)
            bound.listen(128)  # who asks for a port that is taken must be told so
        except OSError:
            bound.close()
            raise
        return bound
    except (OSError, UnicodeError, OverflowError) as error:
        raise InputError(
            f"cannot listen there ({getattr(error, 'strerror', None) or error})",
            where=f"--host {host} --port {port}",
            allowed="an address of this machine, such as 127.0.0.1, and a free port; 0 takes one",
        ) from error
