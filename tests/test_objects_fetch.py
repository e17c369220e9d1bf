"""Fetching YCB from a server on this machine that breaks off, changes its mind and lies."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import re
import tarfile
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.io.meshes import load_mesh
from pointsdf_cli.objects.archive import extract_mesh
from pointsdf_cli.objects.download import Patience, download
from pointsdf_cli.objects.fetch import LOCK, fetch_ycb
from pointsdf_cli.objects.ycb_names import YCB_OBJECTS, choose_ycb

NAME = "003_cracker_box"
QUICK = Patience(attempts=3, first_wait=0.01, longest_wait=0.02, timeout=5.0)


@dataclass
class Server:
    """What the server holds and how it behaves.

    Attributes:
        files: Path to bytes.
        break_after: Bytes of a body after which each connection is cut, None for never.
        ranges: Whether range requests are honoured.
        fail_first: How many requests are answered with status 503.
        seen: The `Range` header of each request, None where there was none.
    """

    files: dict[str, bytes] = field(default_factory=dict)
    break_after: int | None = None
    ranges: bool = True
    fail_first: int = 0
    seen: list[str | None] = field(default_factory=list)
    url: str = ""

    def put(self, name: str, data: bytes) -> str:
        self.files[f"/{name}_google_16k.tgz"] = data
        return f"{self.url}{name}_google_16k.tgz"


@pytest.fixture
def server() -> Iterator[Server]:
    state = Server()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            state.seen.append(self.headers.get("Range"))
            data = state.files.get(self.path)
            if state.fail_first > 0:
                state.fail_first -= 1
                self.send_error(503)
                return
            if data is None:
                self.send_error(404)
                return
            tag = f'"{hashlib.md5(data).hexdigest()}"'
            start, wanted = 0, self.headers.get("Range")
            if state.ranges and wanted and self.headers.get("If-Range") == tag:
                start = int(wanted.removeprefix("bytes=").rstrip("-"))
                if start >= len(data):
                    self.send_error(416)
                    return
                self.send_response(206)
                self.send_header("Content-Range", f"bytes {start}-{len(data) - 1}/{len(data)}")
            else:
                self.send_response(200)
            self.send_header("ETag", tag)
            self.send_header("Content-Length", str(len(data) - start))
            self.end_headers()
            body = data[start:]
            self.wfile.write(body[: state.break_after])
            self.close_connection = True

        def log_message(self, *_: object) -> None:
            pass

    http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    state.url = f"http://127.0.0.1:{http.server_address[1]}/"
    thread = threading.Thread(target=http.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    yield state
    http.shutdown()
    http.server_close()


def box_ply() -> bytes:
    return bytes(trimesh.creation.box((0.06, 0.16, 0.21)).export(file_type="ply"))


def archive_of(*members: tuple[str, bytes]) -> bytes:
    """A .tgz with the given files."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as tar:
        for name, data in members:
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            tar.addfile(entry, io.BytesIO(data))
    return buffer.getvalue()


def good_archive(name: str = NAME) -> bytes:
    folder = f"{name}/google_16k"
    noise = np.random.default_rng(0).bytes(200_000)
    return archive_of(
        (f"{folder}/texture_map.png", noise), (f"{folder}/nontextured.ply", box_ply())
    )


def test_archive_becomes_a_mesh_and_a_lock_entry(server: Server, tmp_path: Path) -> None:
    data = good_archive()
    server.put(NAME, data)
    states, refused = fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)
    assert states == {NAME: "fetched"}
    assert not refused
    mesh = load_mesh(tmp_path / f"{NAME}.ply")
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx((0.06, 0.16, 0.21), abs=1e-6)
    entry = json.loads((tmp_path / LOCK).read_text())["objects"][NAME]
    assert entry["sha256"] == hashlib.sha256(data).hexdigest()
    assert entry["size"] == len(data)
    # Nothing else of the archive is kept.
    left = [path.name for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(left) == sorted([f"{NAME}.ply", LOCK])


def test_mesh_that_is_there_is_not_fetched_again(server: Server, tmp_path: Path) -> None:
    server.put(NAME, good_archive())
    fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)
    requests = len(server.seen)
    states, _ = fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)
    assert states == {NAME: "kept"}
    assert len(server.seen) == requests


def test_a_run_killed_at_the_lock_leaves_no_mesh_without_its_sum(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.put(NAME, good_archive())
    with monkeypatch.context() as patch:

        def killed(*_: object) -> None:
            raise KeyboardInterrupt

        patch.setattr("pointsdf_cli.objects.fetch._add_to_lock", killed)
        with pytest.raises(KeyboardInterrupt):
            fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)
    assert not (tmp_path / f"{NAME}.ply").exists()
    states, refused = fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)
    assert (states, refused) == ({NAME: "fetched"}, [])
    # Or killed right after the lock: the mesh is missing, and fetched again.
    (tmp_path / f"{NAME}.ply").unlink()
    assert fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)[0] == {NAME: "fetched"}


def test_broken_transfers_resume_where_they_broke(server: Server, tmp_path: Path) -> None:
    data = good_archive()
    url = server.put(NAME, data)
    server.break_after = len(data) // 4 + 1
    sha256 = download(url, tmp_path / "file", QUICK)
    assert sha256 == hashlib.sha256(data).hexdigest()
    assert (tmp_path / "file").read_bytes() == data
    starts = [int(seen.removeprefix("bytes=")[:-1]) if seen else 0 for seen in server.seen]
    assert starts == [index * server.break_after for index in range(4)]
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_part_of_a_killed_run_is_resumed(server: Server, tmp_path: Path) -> None:
    data = good_archive()
    url = server.put(NAME, data)
    server.break_after = 1000
    with pytest.raises(RgraspError):
        download(url, tmp_path / "file", Patience(attempts=1, first_wait=0.01))
    assert (tmp_path / "file.part").stat().st_size == 1000
    server.break_after = None
    download(url, tmp_path / "file", QUICK)
    assert server.seen[-1] == "bytes=1000-"
    assert (tmp_path / "file").read_bytes() == data


def test_part_of_an_older_file_is_thrown_away(server: Server, tmp_path: Path) -> None:
    url = server.put(NAME, good_archive())
    server.break_after = 1000
    with pytest.raises(RgraspError):
        download(url, tmp_path / "file", Patience(attempts=1, first_wait=0.01))
    server.break_after = None
    newer = archive_of(("a/nontextured.ply", box_ply()))
    server.put(NAME, newer)
    download(url, tmp_path / "file", QUICK)
    assert (tmp_path / "file").read_bytes() == newer


def test_part_of_an_older_file_never_gets_the_tag_of_the_newer(
    server: Server, tmp_path: Path
) -> None:
    path = tmp_path / "a"
    old, new = b"a" * 3000, b"b" * 4000
    part, tag = tmp_path / "a.part", tmp_path / "a.tag"
    part.write_bytes(old[:500])
    tag.write_text(f'"{hashlib.md5(old).hexdigest()}"')
    server.files["/a"] = new
    with pytest.raises(InputError):
        download(server.url + "a", path, Patience(largest=2000))
    download(server.url + "a", path, Patience(largest=5000))
    assert path.read_bytes() == new


def test_a_header_with_a_number_that_is_none_is_refused(tmp_path: Path) -> None:
    archive = tmp_path / "evil.tgz"
    with tarfile.open(archive, "w:gz", format=tarfile.PAX_FORMAT) as tar:
        member = tarfile.TarInfo("x/nontextured.ply")
        member.pax_headers = {"GNU.sparse.major": "0", "GNU.sparse.size": "abc"}
        tar.addfile(member)
    with pytest.raises(InputError, match="not a readable tar archive"):
        extract_mesh(archive, tmp_path / "mesh")


def test_server_without_ranges_is_asked_from_the_start(server: Server, tmp_path: Path) -> None:
    data = good_archive()
    url = server.put(NAME, data)
    server.ranges, server.break_after = False, 1000
    with pytest.raises(RgraspError):
        download(url, tmp_path / "file", QUICK)
    server.break_after = None
    assert download(url, tmp_path / "file", QUICK) == hashlib.sha256(data).hexdigest()


def test_failures_that_pass_are_retried_and_those_that_stay_are_told(
    server: Server, tmp_path: Path
) -> None:
    url = server.put(NAME, b"data")
    server.fail_first = 2
    download(url, tmp_path / "file", QUICK)
    server.fail_first = 3
    with pytest.raises(RgraspError, match="503"):
        download(url, tmp_path / "file", QUICK)
    assert len(server.seen) == 6


def test_nobody_listening_is_an_error_and_no_mistake_of_the_user(tmp_path: Path) -> None:
    with pytest.raises(RgraspError, match="cannot be fetched") as caught:
        fetch_ycb(tmp_path, ["003"], "http://127.0.0.1:9/", patience=QUICK)
    assert caught.value.exit_code == 1


@pytest.mark.parametrize("kind", [tarfile.REGTYPE, tarfile.GNUTYPE_LONGNAME])
def test_a_member_of_astronomic_size_is_refused(kind: bytes, tmp_path: Path) -> None:
    """Sizes beyond 8 GiB are stored in base 256: 87 bits of them in a damaged header."""
    member = tarfile.TarInfo("a/readme.txt")
    member.type = kind
    header = bytearray(member.tobuf())
    header[124:136] = b"\x80" + b"\x7f" * 11
    header[148:156] = b" " * 8
    header[148:156] = f"{sum(header):06o}\0 ".encode()
    path = tmp_path / "huge.tgz"
    path.write_bytes(gzip.compress(bytes(header) + bytes(1024)))
    with pytest.raises(InputError):
        extract_mesh(path, tmp_path / "mesh")


def test_missing_archive_does_not_stop_the_others(server: Server, tmp_path: Path) -> None:
    server.put("025_mug", good_archive("025_mug"))
    states, refused = fetch_ycb(tmp_path, ["003", "025"], server.url, patience=QUICK)
    assert states == {"025_mug": "fetched"}
    assert "404" in refused[0].message


def test_too_large_a_file_is_refused(server: Server, tmp_path: Path) -> None:
    url = server.put(NAME, good_archive())
    with pytest.raises(InputError, match="bytes"):
        download(url, tmp_path / "file", Patience(largest=1000))


def test_changed_archive_is_refused_once_its_sum_is_known(server: Server, tmp_path: Path) -> None:
    true = good_archive()  # made once: a gzip header holds the second it was made in
    server.put(NAME, true)
    fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)
    before = (tmp_path / f"{NAME}.ply").read_bytes()
    server.put(NAME, archive_of(("a/nontextured.ply", box_ply())))
    states, refused = fetch_ycb(tmp_path, ["003"], server.url, force=True, patience=QUICK)
    assert not states
    assert "has changed" in refused[0].message
    assert (tmp_path / f"{NAME}.ply").read_bytes() == before
    # A fetch of the true archive then works: no wrong part was left behind.
    server.put(NAME, true)
    states, _ = fetch_ycb(tmp_path, ["003"], server.url, force=True, patience=QUICK)
    assert states == {NAME: "fetched"}


def test_mesh_that_was_changed_by_hand_is_not_overwritten(server: Server, tmp_path: Path) -> None:
    server.put(NAME, good_archive())
    fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)
    (tmp_path / f"{NAME}.ply").write_bytes(b"mine")
    _, refused = fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)
    assert "not as it was fetched" in refused[0].message
    assert (tmp_path / f"{NAME}.ply").read_bytes() == b"mine"


def evil(kind: str) -> bytes:
    """An archive that holds a good mesh and one member that tries something."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as tar:
        good = tarfile.TarInfo("a/google_16k/nontextured.ply")
        good.size = len(box_ply())
        tar.addfile(good, io.BytesIO(box_ply()))
        entry = tarfile.TarInfo("a/evil")
        if kind == "absolute":
            entry.name = "/tmp/rgrasp_evil.ply"
        elif kind == "parent":
            entry.name = "a/../../evil.ply"
        elif kind == "symlink":
            entry.type, entry.linkname = tarfile.SYMTYPE, "/etc/passwd"
        elif kind == "hardlink":
            entry.type, entry.linkname = tarfile.LNKTYPE, "a/google_16k/nontextured.ply"
        elif kind == "device":
            entry.type = tarfile.CHRTYPE
        elif kind == "pipe":
            entry.type = tarfile.FIFOTYPE
        tar.addfile(entry)
    return buffer.getvalue()


@pytest.mark.parametrize("kind", ["absolute", "parent", "symlink", "hardlink", "device", "pipe"])
def test_evil_archive_is_refused_and_unpacks_nothing(
    kind: str, server: Server, tmp_path: Path
) -> None:
    server.put(NAME, evil(kind))
    out = tmp_path / "deep" / "out"
    states, refused = fetch_ycb(out, ["003"], server.url, patience=QUICK)
    assert not states
    assert len(refused) == 1
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    assert not Path("/tmp/rgrasp_evil.ply").exists()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "tar"),
        (b"<html>not here</html>", "tar"),
        (gzip.compress(b"\0" * 100), "holds no mesh|tar"),
        (good_archive()[:-2000], "tar"),
        (archive_of(("a/readme.txt", b"hello")), "holds no mesh"),
        (archive_of(("a/nontextured.ply", b"ply\nnonsense")), "cannot be read"),
    ],
    ids=["empty", "html", "no tar", "cut", "no mesh", "broken mesh"],
)
def test_useless_archive_is_one_error(
    data: bytes, words: str, server: Server, tmp_path: Path
) -> None:
    server.put(NAME, data)
    states, refused = fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)
    assert not states
    assert refused[0].exit_code == 2
    assert not list(tmp_path.glob("*.ply"))
    assert re.search(words, refused[0].message)


def test_archive_bomb_is_refused_before_it_unpacks(tmp_path: Path) -> None:
    path = tmp_path / "bomb.tgz"
    path.write_bytes(archive_of(("a/nontextured.ply", b"\0" * 5_000_000)))
    assert path.stat().st_size < 20_000
    with pytest.raises(InputError, match="5000000 bytes"):
        extract_mesh(path, tmp_path / "out", largest=1_000_000)
    assert [p.name for p in tmp_path.iterdir()] == ["bomb.tgz"]


def test_plain_mesh_is_preferred_to_the_textured_one(tmp_path: Path) -> None:
    path = tmp_path / "both.tgz"
    path.write_bytes(archive_of(("a/textured.obj", b"v 0 0 0"), ("a/nontextured.ply", b"first")))
    assert extract_mesh(path, tmp_path / "out").read_bytes() == b"first"


def test_numbers_stand_for_objects() -> None:
    assert choose_ycb(["003", "025_mug"]) == [NAME, "025_mug"]
    assert choose_ycb(["072"]) == [name for name in YCB_OBJECTS if name.startswith("072-")]
    assert choose_ycb(["065-a"]) == ["065-a_cups"]
    assert len(choose_ycb(None)) == len(set(YCB_OBJECTS)) == len(YCB_OBJECTS)
    with pytest.raises(InputError) as caught:
        choose_ycb(["003_craker_box"])
    assert caught.value.hint == f"--objects {NAME}"


def test_broken_lock_file_is_named(server: Server, tmp_path: Path) -> None:
    (tmp_path / LOCK).write_text("{")
    with pytest.raises(InputError, match="lock"):
        fetch_ycb(tmp_path, ["003"], server.url, patience=QUICK)


def test_command_fetches_and_draws(server: Server, tmp_path: Path, cli: Callable) -> None:  # type: ignore[type-arg]
    server.put(NAME, good_archive())
    out = tmp_path / "ycb"
    arguments = ["objects", "fetch", "ycb", "--out", out, "--base-url", server.url]
    result = cli(*arguments, "--objects", "003", "--sheet", tmp_path / "s.png", "--json")
    assert result.code == 0, result.err
    assert json.loads(result.out)["fetched"] == [NAME]
    assert (tmp_path / "s.png").stat().st_size > 1000
    missing = cli(*arguments, "--objects", "024")
    assert missing.code == 2
    assert "404" in missing.err
    assert cli("objects", "fetch", "kit", "--out", out).code == 2
