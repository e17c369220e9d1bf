"""Address of a server, as typed."""

from __future__ import annotations

import os
from urllib.parse import urlsplit

from pointsdf_cli.errors import InputError

PORT = 8765
LOOPBACK = ("127.0.0.1", "localhost", "::1")
TOKEN = "RGRASP_TOKEN"
"""The variable of the environment that holds a server's token."""


def read_token() -> str | None:
    """The secret of the environment's variable `TOKEN`; None if it is not set or empty.

    Raises:
        InputError: It cannot stand in a header.
    """
    token = os.environ.get(TOKEN) or None
    if token is not None and not all("!" <= sign <= "~" for sign in token):
        raise InputError(
            "holds blanks or signs beyond ASCII", where=TOKEN, allowed="printable ASCII"
        )
    return token


def server_address(url: str) -> str:
    """`url` up to its port.

    Raises:
        InputError: Not http or https with a host, or more than that.
    """
    try:
        parts = urlsplit(url)
        known = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        known = False
    if not known or parts.path not in ("", "/") or parts.query or parts.fragment or parts.username:
        raise InputError(
            f"{url!r} is not a server's address",
            where="--server",
            allowed=f"such as http://127.0.0.1:{PORT}",
            hint="`rgrasp serve` prints its address when it starts",
        )
    return f"{parts.scheme}://{parts.netloc}"
