"""Input files: ordinary ones of a bounded size, wherever they are named."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.input_files import (
    LARGEST,
    VARIABLE,
    allow_inputs_of,
    check_input,
    largest_input,
    open_input,
    read_input,
)

BOX = trimesh.creation.box((0.08, 0.06, 0.04))


@pytest.fixture(autouse=True)
def _none_waits(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv(VARIABLE, "")  # as it is afterwards: not at all
    started = time.monotonic()
    yield
    assert time.monotonic() - started < 30


def test_an_ordinary_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    (tmp_path / "link").symlink_to("a")
    assert read_input(tmp_path / "link", "text") == b"abc"
    with open_input(tmp_path / "a", "cloud") as handle:
        assert handle.read(2) == b"ab"


def test_what_is_no_ordinary_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
        for path, told in (
            (tmp_path / "pipe", "is a pipe or a device"),
            (tmp_path / "socket", "is a pipe or a device"),
            (Path("/dev/zero"), "is a pipe or a device"),
            (tmp_path, "is a folder, and a point cloud is needed"),
            (tmp_path / "none", "no such file"),
            (tmp_path / ("n" * 300), "no such file"),
            (tmp_path / "a\0b", "no such file"),
            (tmp_path / "loop", "cannot be read"),
        ):
            with pytest.raises(InputError, match=told):
                check_input(path, "cloud")


def sparse(path: Path, size: int, begin: bytes = b"") -> Path:
    with open(path, "wb") as handle:
        handle.write(begin)
        handle.truncate(size)
    return path


def test_a_size_beyond_the_bound_is_refused_and_may_be_allowed(tmp_path: Path) -> None:
    path = sparse(tmp_path / "a.ply", 3 * LARGEST["cloud"])
    with pytest.raises(InputError, match=r"larger than 256 MB.*(.|\n)*--largest-input 1G"):
        check_input(path, "cloud")
    check_input(path, "artifact")
    allow_inputs_of("1G")
    check_input(path, "cloud")
    assert largest_input("artifact") == LARGEST["artifact"]  # raised, and never lowered


@pytest.mark.parametrize("text", ["", "much", "-1G", "1e9", "5X", "9" * 40])
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--largest-input"):
        allow_inputs_of(text)


@pytest.mark.parametrize(
    "name", ["a.ply", "a.xyz", "a.csv", "a.npy", "a.pcd", "a.obj", "a.stl", "a.h5", "ckpt"]
)
def test_info_waits_for_no_pipe(cli: Callable[..., Any], tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "ckpt":
        path.mkdir()
        os.mkfifo(path / "config.json")
    else:
        os.mkfifo(path)
    run = cli("info", path)
    assert run.code == 2
    assert len(run.err.splitlines()) <= 3, run.err


def test_a_pipe_among_meshes_is_a_bad_one(cli: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "m").mkdir()
    BOX.export(tmp_path / "m" / "box.ply")
    os.mkfifo(tmp_path / "m" / "pipe.ply")
    made = ("render", "--meshes", tmp_path / "m", "--out", tmp_path / "v", "--views", 2, "-j", 1)
    run = cli(*made, "-q")
    assert run.code == 2
    assert "pipe.ply: is a pipe or a device" in run.err
    assert [path.name for path in (tmp_path / "v").iterdir()] == ["box.h5"]


@pytest.mark.parametrize("option", ["--camera-pose", "--start", "--robot", "--environment"])
def test_no_option_waits_for_a_pipe(
    cli: Callable[..., Any], tmp_path: Path, mug: Path, option: str
) -> None:
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    run = cli("plan", mug, "--out", tmp_path / "p.h5", "--no-picture", option, pipe)
    assert run.code == 2
    assert "pipe" in run.err
    assert not (tmp_path / "p.h5").exists()


@pytest.fixture
def mug() -> Path:
    return Path(__file__).resolve().parents[1] / "assets" / "clouds" / "mug.ply"


@pytest.mark.parametrize("suffix", [".xyz", ".ply", ".npy", ".stl", ".pcd"])
def test_30_gigabytes_of_nothing_cost_a_message(
    cli: Callable[..., Any], tmp_path: Path, suffix: str
) -> None:
    run = cli("info", sparse(tmp_path / f"a{suffix}", 30 << 30))
    assert run.code == 2
    assert "larger than 256 MB (30720 MB)" in run.err


def test_a_line_that_does_not_end_is_no_table(cli: Callable[..., Any], tmp_path: Path) -> None:
    path = sparse(tmp_path / "a.xyz", 200 << 20, b"0 0 1\n" * 60)
    run = cli("info", path)
    assert run.code == 2
    assert "has a line of more than" in run.err


def test_a_header_that_promises_more_than_the_file_holds_allocates_nothing(tmp_path: Path) -> None:
    import tracemalloc

    from pointsdf_cli.io.clouds import read_cloud

    properties = "".join(f"property double {axis}\n" for axis in "xyz")
    for form in ("ascii", "binary_little_endian"):
        text = f"ply\nformat {form} 1.0\nelement vertex 900000000\n{properties}end_header\n"
        (tmp_path / "a.ply").write_text(text)
        tracemalloc.start()
        with pytest.raises(InputError, match="promises 900000000 points"):
            read_cloud(tmp_path / "a.ply")
        assert tracemalloc.get_traced_memory()[1] < 5 << 20
        tracemalloc.stop()


def test_the_option_reaches_the_readers(
    cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(LARGEST, "cloud", 1000)  # type: ignore[misc]
    np.savetxt(tmp_path / "a.xyz", np.random.default_rng(0).normal(size=(60, 3)))
    assert "larger than" in cli("info", tmp_path / "a.xyz").err
    assert cli("--largest-input", "1M", "info", tmp_path / "a.xyz").code == 0
    assert cli("--largest-input", "big", "info", tmp_path / "a.xyz").code == 2
