"""Access to the viewer's server: only for pages that it served itself.

Browsers let any page open a WebSocket to any address, including this machine's, and send the page's
origin in `Origin`. viser does not check it: without this module a page from elsewhere could read
the scene while the viewer runs.
"""

from __future__ import annotations

import http
import ipaddress
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any
from urllib.parse import urlsplit

from pointsdf_cli.errors import InputError

LARGEST_MESSAGE = 1 << 20
"""Largest message from a browser in bytes: camera pose, checkboxes."""
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


def may_connect(origin: str | None, host_header: str | None, bound: str) -> bool:
    """Whether a WebSocket may be opened.

    Args:
        origin: Origin of the requesting page; None without a browser.
        host_header: Address that the browser uses for the server.
        bound: Address at which the server listens.
    """
    if origin is None:
        return True
    page, asked = _name_of(origin), _name_of(f"//{host_header or ''}")
    if page is None or asked is None:
        return False
    if page in _LOOPBACK and asked in _LOOPBACK:
        return True  # by SSH the port may be another one there
    if bound in _LOOPBACK or origin.partition("//")[2] != host_header:
        return False
    # Others control where foreign names lead (DNS rebinding).
    return _is_address(page) or page in (bound, socket.gethostname(), socket.getfqdn())


def free_port(host: str, port: int) -> int:
    """Find the first free port from `port` on.

    viser binds in a thread of its own, and waits for ever if that fails.

    Raises:
        InputError: The host is none of this machine's, or no port is free.
    """
    problem: Exception | None = None
    for candidate in range(port, min(port + 100, 65536)):
        try:
            kind, *_, address = socket.getaddrinfo(host, candidate, type=socket.SOCK_STREAM)[0]
            with socket.socket(kind) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
            return candidate
        except (OSError, UnicodeError) as error:
            problem = error
            if isinstance(error, (socket.gaierror, UnicodeError)):
                break
    raise InputError(
        f"cannot listen there ({getattr(problem, 'strerror', None) or problem})",
        where=f"--host {host} --port {port}",
        allowed="an address of this machine, such as 127.0.0.1 or 0.0.0.0, and a free port",
    ) from problem


@contextmanager
def guarded(bound: str) -> Iterator[list[Any]]:
    """Context in which WebSocket servers that start ask `may_connect`; yields a list of them."""
    import websockets.asyncio.server as library

    serve: Callable[..., Any] = library.serve
    started: list[Any] = []

    def guarded_serve(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        def ask(connection: Any, request: Any) -> Any:
            headers = request.headers
            # A page may send a header twice: check all values, not only the last.
            origins, hosts = headers.get_all("Origin"), headers.get_all("Host")
            ok = len(origins) < 2 and len(hosts) == 1
            ok = ok and may_connect(next(iter(origins), None), hosts[0], bound)
            if not ok:
                return connection.respond(http.HTTPStatus.FORBIDDEN, "not from this page\n")
            return None if process_request is None else process_request(connection, request)

        options["max_size"] = LARGEST_MESSAGE
        server = serve(*arguments, process_request=ask, **options)
        started.append(server)
        return server

    library.serve = guarded_serve  # type: ignore[misc, assignment]
    try:
        yield started
    finally:
        library.serve = serve  # type: ignore[misc, assignment]


def only_controls(server: Any) -> bool:
    """Let clients change the values of controls and nothing else.

    By default viser also accepts files of any size from any client, changes any property of a
    control, and opens a public address for the scene when a client asks for one.

    Args:
        server: viser's server of WebSockets, once all controls are made.

    Returns:
        Whether this version of viser can be told so.
    """
    handlers: dict[Any, list[Callable[..., Any]]] = getattr(server, "_incoming_handlers", {})
    kinds = {kind.__name__: kind for kind in handlers}
    update = kinds.pop("GuiUpdateMessage", None)
    if update is None or len(handlers[update]) != 1:
        return False
    for kind in kinds.values():
        server.unregister_handler(kind)
    (usual,) = handlers[update]

    async def values_alone(client: Any, message: Any) -> None:
        if set(message.updates) == {"value"}:
            with suppress(TypeError, ValueError, OverflowError):  # no value of this control
                await usual(client, message)

    server.unregister_handler(update)
    server.register_handler(update, values_alone)
    return True


def _name_of(url: str) -> str | None:
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
