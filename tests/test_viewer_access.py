"""The viewer's server: where it listens, what it hands out, to whom, and how much it takes."""

from __future__ import annotations

import http.client
import socket
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from pointsdf_cli.errors import InputError
from pointsdf_cli.viz.scene import Part, Scene
from pointsdf_cli.viz.viewer_access import LARGEST_MESSAGE, free_port, may_connect

SECRET = b"a-cloud-of-my-kitchen"


@pytest.mark.parametrize(
    ("origin", "host", "bound", "may"),
    [
        (None, "localhost:8080", "127.0.0.1", True),
        ("http://localhost:8080", "localhost:8080", "127.0.0.1", True),
        ("http://127.0.0.1:8080", "127.0.0.1:8080", "127.0.0.1", True),
        ("http://localhost:9000", "localhost:9000", "127.0.0.1", True),  # ssh -L 9000:…
        ("http://[::1]:8080", "[::1]:8080", "::1", True),
        ("https://evil.example", "localhost:8080", "127.0.0.1", False),
        ("https://evil.example", "evil.example", "127.0.0.1", False),  # DNS rebinding
        ("http://localhost.evil.example", "localhost:8080", "127.0.0.1", False),
        ("null", "localhost:8080", "127.0.0.1", False),  # a sandboxed frame, a file
        ("", "localhost:8080", "127.0.0.1", False),
        ("http://[", "localhost:8080", "127.0.0.1", False),
        ("http://192.168.0.7:8080", "192.168.0.7:8080", "0.0.0.0", True),
        (f"http://{socket.gethostname()}:80", f"{socket.gethostname()}:80", "0.0.0.0", True),
        ("http://evil.example:8080", "evil.example:8080", "0.0.0.0", False),
        ("http://192.168.0.8:8080", "192.168.0.7:8080", "0.0.0.0", False),
        ("http://192.168.0.7:8080", "192.168.0.7:8080", "127.0.0.1", False),
    ],
)
def test_only_a_page_of_the_viewer_may_connect(
    origin: str | None, host: str, bound: str, may: bool
) -> None:
    assert may_connect(origin, host, bound) is may


def test_a_port_in_use_is_passed_over_and_the_last_one_is_an_error() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert free_port("127.0.0.1", port) > port
    with socket.socket() as last:
        last.bind(("127.0.0.1", 65535))
        last.listen()
        with pytest.raises(InputError, match="cannot listen there"):
            free_port("127.0.0.1", 65535)
    for host in ("no.such.host.invalid", "8.8.8.8", "a" * 300, "é" * 70):
        with pytest.raises(InputError, match="cannot listen there"):
            free_port(host, 8080)


@pytest.fixture(scope="module")
def viewer() -> Iterator[Any]:
    pytest.importorskip("viser", reason="viser is not installed (pip install '.[view]')")
    from pointsdf_cli.viz.viewer import Viewer

    points = np.zeros((3, 3), np.float32)
    part = Part("p", "cloud", "points", points, None, np.ones((3, 3), np.float32))
    with Viewer(Scene(SECRET.decode(), (part,)), "127.0.0.1", 18080) as running:
        yield running


def test_it_listens_on_this_machine_alone(viewer: Any) -> None:
    listening = []
    for file in ("/proc/net/tcp", "/proc/net/tcp6"):
        with open(file, encoding="ascii") as table:
            rows = [line.split() for line in table.readlines()[1:]]
        listening += [row[1] for row in rows if row[3] == "0A"]
    mine = [entry for entry in listening if entry.endswith(f":{viewer.port:04X}")]
    assert mine == [f"0100007F:{viewer.port:04X}"]


@pytest.mark.parametrize(
    "path",
    [
        "/../../../../../../etc/passwd", "/%2e%2e/%2e%2e/%2e%2e/%2e%2e/etc/passwd",
        "/..%2f..%2f..%2f..%2fetc/passwd", "/..\\..\\..\\etc\\passwd", "//etc/passwd",
        "/%00", "/assets/", "/none",
    ],
)  # fmt: skip
def test_it_hands_out_its_own_page_and_no_other_file(viewer: Any, path: str) -> None:
    def get(what: str) -> tuple[int, bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", viewer.port, timeout=10)
        connection.putrequest("GET", what, skip_host=False)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.read()

    status, body = get(path)
    assert status in (400, 404, 500), path
    assert b"root:" not in body
    status, page = get("/")
    assert (status, b"<html" in page) == (200, True)
    assert SECRET not in page  # the scene goes through the WebSocket alone


def test_a_page_from_elsewhere_reads_no_scene(viewer: Any) -> None:
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    version = __import__("viser").__version__
    address = f"ws://127.0.0.1:{viewer.port}"

    def first_message(origin: str | None) -> bytes:
        with connect(
            address, origin=origin, subprotocols=[f"viser-v{version}"], max_size=None,  # type: ignore
            compression=None, open_timeout=10,
        ) as client:  # fmt: skip
            return bytes(client.recv(timeout=10))

    assert first_message(f"http://localhost:{viewer.port}")
    assert first_message(None)
    for origin in ("https://evil.example", "null", f"http://evil.example:{viewer.port}"):
        with pytest.raises(InvalidStatus, match="403"):
            first_message(origin)


def test_a_message_beyond_all_measure_ends_the_connection_and_not_the_server(viewer: Any) -> None:
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    version = __import__("viser").__version__
    options: Any = {"subprotocols": [f"viser-v{version}"], "max_size": None, "compression": None}
    for message in (b"\xff" * (LARGEST_MESSAGE + 1), b"\xff" * 100, b""):
        with connect(f"ws://127.0.0.1:{viewer.port}", **options) as client:
            try:
                client.send(message)
                for _ in range(1000):
                    client.recv(timeout=2)
            except (ConnectionClosed, TimeoutError):
                pass
    with connect(f"ws://127.0.0.1:{viewer.port}", **options) as client:
        assert client.recv(timeout=10)


def test_a_client_changes_values_and_nothing_else(
    viewer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    import msgspec
    from viser import _messages as messages
    from websockets.sync.client import connect

    shared: list[str] = []
    monkeypatch.setattr(viewer._server, "request_share_url", lambda: shared.append("asked"))
    slider = viewer._slider
    known = {"uuid": slider._impl.uuid}
    upload = {
        "source_component_uuid": slider._impl.uuid, "transfer_uuid": "t", "filename": "f",
        "mime_type": "m", "part_count": 9, "size_bytes": 9,
    }  # fmt: skip
    sent: list[Any] = [
        messages.ShareUrlRequest(),
        messages.FileTransferStartUpload(**upload),
        messages.GuiUpdateMessage(**known, updates={"removed": True}),
        messages.GuiUpdateMessage(**known, updates={"update_cb": None, "value": 0}),
        messages.GuiUpdateMessage(**known, updates={"value": float("inf")}),
        messages.GuiUpdateMessage(**known, updates={"value": "nothing"}),
        messages.GuiUpdateMessage(**known, updates={"value": 1}),
    ]
    version = __import__("viser").__version__
    address, options = f"ws://127.0.0.1:{viewer.port}", {"subprotocols": [f"viser-v{version}"]}
    with connect(address, max_size=None, compression=None, **options) as client:  # type: ignore
        for message in sent:
            client.send(msgspec.msgpack.encode(message.as_serializable_dict()))
        end = time.monotonic() + 20
        while slider.value != 1:
            assert time.monotonic() < end, "the value is not taken"
            time.sleep(0.05)
    time.sleep(0.2)  # what viser does in threads
    assert shared == []
    assert viewer._server.gui._current_file_upload_states == {}
    assert not slider._impl.removed
    assert slider._impl.update_cb
