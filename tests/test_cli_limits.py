"""Closed streams, limits of memory, empty arguments, control characters: one message each."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from test_cli_main import MUG, in_shell

from pointsdf_cli.cli.main import _told
from pointsdf_cli.cli.memory import is_lack_of_memory
from pointsdf_cli.cli.printable import on_one_line, printable, printable_json
from pointsdf_cli.io.hdf5 import write_artifact
from pointsdf_cli.io.layout import Column

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="limits address space as Linux does")


def test_a_closed_output_is_taken_for_none(tmp_path: Path) -> None:
    for closed in (">&-", ">&- 2>&-", "<&- >&- 2>&-"):
        run = in_shell(f"rgrasp info {MUG} {closed}")
        assert (run.returncode, run.stdout, run.stderr) == (0, "", ""), closed
    failed = in_shell(f"rgrasp info {tmp_path / 'none.ply'} >&-")
    assert failed.returncode == 2
    assert failed.stderr.splitlines() == [f"rgrasp: {tmp_path / 'none.ply'}: no such file"]


def test_what_is_printed_to_a_closed_output_is_in_no_file(tmp_path: Path) -> None:
    # The first file to be opened would get the number of the closed stream.
    code = (
        "import os\nfrom pointsdf_cli.cli.main import _open_closed_streams\n"
        "_open_closed_streams()\n"
        f"handle = os.open({str(tmp_path / 'a')!r}, os.O_CREAT | os.O_WRONLY)\n"
        "os.write(1, b'from a library')\nassert handle > 2\n"
    )
    done = subprocess.run(
        ["bash", "-c", '"$0" -c "$1" >&-', sys.executable, code], capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a").read_bytes() == b""


@pytest.mark.parametrize(
    ("words", "where"),
    [
        (["mesh", MUG, "--out", ""], "--out"),
        (["mesh", MUG, "--out="], "--out"),
        (["mesh", MUG, "--out", "  "], "--out"),
        (["mesh", ""], "the command line"),
        (["render", "--meshes", "", "--out", "views"], "--meshes"),
        (["trial", "--out", ""], "--out"),
        (["report", ""], "the command line"),
    ],
)
def test_an_empty_argument_is_not_the_folder_where_one_is(
    cli: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: list[Any],
    where: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    run = cli(*words)
    assert run.code == 2
    assert f"{where}: an argument is empty" in run.err
    assert list(tmp_path.iterdir()) == []


@LINUX
def test_a_limit_of_address_space_is_one_message(tmp_path: Path) -> None:
    few = in_shell(f"ulimit -v {200 << 10}; rgrasp plan {MUG} --out {tmp_path / 'p.h5'}")
    # 80 million points of a byte a number: 240 MB as stored, 2 GB as coordinates.
    np.lib.format.open_memmap(tmp_path / "a.npy", "w+", np.uint8, (80_000_000, 3))
    more = in_shell(f"ulimit -v {1100 << 10}; rgrasp info {tmp_path / 'a.npy'}")
    told = ("the limit of address space is 200 MB", "not enough memory")
    for run, words in zip((few, more), told, strict=True):
        assert run.returncode == 1
        assert "Traceback" not in run.stderr
        assert words in run.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["a.npy"]


def test_lack_of_memory_is_known_by_what_libraries_say() -> None:
    torch_says = RuntimeError("[enforce fail at alloc_cpu.cpp:117] DefaultCPUAllocator: can't "
                              "allocate memory: you tried to allocate 8 bytes.")  # fmt: skip
    wrapped = ValueError("something else")
    wrapped.__cause__ = MemoryError()
    for error in (MemoryError(), torch_says, OSError(12, "Cannot allocate memory"), wrapped):
        assert is_lack_of_memory(error), error
    for error in (RuntimeError("shapes differ"), OSError(2, "No such file"), KeyError("memory")):
        assert not is_lack_of_memory(error), error


def test_what_may_not_be_read_is_no_place_to_write() -> None:
    for number in (errno.EACCES, errno.EPERM):
        told = _told(OSError(number, os.strerror(number), "/locked/a.ply")).message
        assert told.startswith("/locked/a.ply: permission denied")
    full = _told(OSError(errno.ENOSPC, "No space left on device", "/a/plan.h5")).message
    assert full.startswith("/a/plan.h5: the disk is full")


def test_escape_sequences_are_shown_and_not_obeyed(cli: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    layout = {"x": Column("f8 [1]")}
    write_artifact(path, schema="s", version=1, layout=layout, arrays={"x": np.zeros(1)})
    with h5py.File(path, "a") as file:
        file.attrs["\x1b[2Jname\n  forged: line"] = "\x1b]0;title\x07 \x9b31m \u202egnp.exe"
        file["x"].attrs["units"] = "\x1b[31mm"
    run = cli("info", path)
    assert run.code == 0
    assert not any(sign in run.out for sign in "\x1b\x07\x9b\u202e")
    assert "\\x1b[2Jname\\n  forged: line: \\x1b]0;title\\x07 \\x9b31m \\u202egnp.exe" in run.out
    told = cli("info", "--json", path).out
    assert not any(sign in told for sign in "\x1b\x07\x9b\u202e")
    assert json.loads(told)["facts"]["\x1b[2Jname\n  forged: line"].startswith("\x1b]0;title")
    wrong = cli("info", tmp_path / "\x1b[31mred.ply")
    assert "\x1b" not in wrong.err
    assert "\\x1b[31mred.ply: no such file" in wrong.err


def test_usual_text_is_printed_as_it_is() -> None:
    text = "é 10 % ≤ µm — 日本\ttab\nline"
    assert printable(text) == text
    assert on_one_line(text) == text.replace("\n", "\\n")
    assert json.loads(printable_json(json.dumps(text, ensure_ascii=False))) == text
