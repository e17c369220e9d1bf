"""Signals, pipes, full devices and narrow encodings: what the boundary makes of them."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer

from pointsdf_cli.cli import app as app_module
from pointsdf_cli.cli.main import STOPPED
from pointsdf_cli.cli.signals import stop_requests
from pointsdf_cli.robot.description import load_robot

MUG = Path(__file__).resolve().parents[1] / "assets" / "clouds" / "mug.ply"


def in_shell(line: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """A line of bash in which `rgrasp` is this one."""
    program = f"{shlex.quote(sys.executable)} -m pointsdf_cli.cli.main"
    return subprocess.run(
        ["bash", "-c", f'rgrasp() {{ {program} "$@"; }}; {line}'],
        env={**os.environ, **variables}, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_an_interruption_while_libraries_load_is_not_swallowed(tmp_path: Path) -> None:
    (tmp_path / "greedy.py").write_text("try:\n    import slow\nexcept BaseException:\n    pass\n")
    (tmp_path / "slow.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\ntime.sleep(5)\n"
    )
    # Where the tests run in the background, the shell has Ctrl-C ignored.
    code = (
        "import signal\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from pointsdf_cli.cli.main import _interruptible_imports as guard\n"
        "with guard():\n    import greedy\nprint('went on')\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(tmp_path)},
        cwd=MUG.parents[2], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 130
    assert run.stderr.strip() == STOPPED
    assert run.stdout == ""


@pytest.mark.parametrize(
    ("handler", "code", "out", "err"),
    [
        (signal.default_int_handler, 130, "", f"{STOPPED}\n"),
        (signal.SIG_IGN, 0, "went on\n", ""),  # as behind `nohup … &`
    ],
    ids=["heard", "ignored"],
)
def test_an_interruption_elsewhere_is_one_line(
    cli: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    handler: Any,
    code: int,
    out: str,
    err: str,
) -> None:
    interrupted = typer.Typer()

    @interrupted.command()
    def interrupt() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        print("went on")

    monkeypatch.setattr(app_module, "app_of", lambda arguments: interrupted)
    before = signal.signal(signal.SIGINT, handler)
    try:
        run = cli()
        assert (run.code, run.out, run.err) == (code, out, err)
        assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_a_request_to_stop_says_with_what_to_leave(name: str, code: int) -> None:
    number = getattr(signal, name)
    before = signal.signal(number, signal.default_int_handler)  # a shell may have it ignored
    try:
        with stop_requests() as asked:
            assert not asked()
            os.kill(os.getpid(), number)
            assert asked()
        assert asked.exit_code == code
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)


def test_what_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with stop_requests() as asked:
            os.kill(os.getpid(), signal.SIGINT)
            assert not asked()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_reader_that_leaves_is_told_by_the_code() -> None:
    run = in_shell(f"rgrasp info {MUG} | true; echo ${{PIPESTATUS[0]}}")
    assert run.stdout.strip() == "141"
    assert run.stderr == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_output_is_no_bad_input() -> None:
    run = in_shell(f"rgrasp info {MUG} > /dev/full")
    assert run.returncode == 1
    assert run.stderr.startswith("rgrasp: the output cannot be written (No space")
    assert "Traceback" not in run.stderr


def test_output_that_cannot_show_a_sign_is_no_failure(tmp_path: Path) -> None:
    odd = tmp_path / "é.ply"
    odd.write_bytes(MUG.read_bytes())
    plain = in_shell(f"rgrasp info {odd}", PYTHONIOENCODING="ascii")
    assert plain.returncode == 0, plain.stderr
    assert "\\xe9.ply" in plain.stdout
    told = in_shell(f"rgrasp info --json {odd}", PYTHONIOENCODING="ascii")
    assert told.returncode == 0, told.stderr
    assert str(odd) in json.dumps(json.loads(told.stdout), ensure_ascii=False)


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("plan a.ply --out plan.h5 --trajectory a.ply --force --no-picture", "a.ply"),
        ("plan a.ply --camera-pose pose.json --trajectory pose.json --force", "pose.json"),
        ("report a.ply --out a.ply --force", "a.ply"),
        ("robot init r.urdf --out r.urdf --force", "r.urdf"),
    ],
)
def test_no_output_replaces_an_input(
    cli: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    command: str,
    names: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(MUG, "a.ply")
    shutil.copy(load_robot().urdf, "r.urdf")
    Path("pose.json").write_text("[1, 0, 1, 1, 0, 0, 0]")
    before = Path(names).read_bytes()
    run = cli(*command.split())
    assert run.code == 2
    assert f"{names}: is an input" in run.err
    assert Path(names).read_bytes() == before


@pytest.mark.parametrize(
    ("option", "text"),
    [("--camera-pose", "[NaN, 0, 0.5, 1, 0, 0, 0]"), ("--target", "[NaN, 0, 0]")],
)
def test_numbers_in_a_file_are_finite(
    cli: Callable[..., Any], tmp_path: Path, option: str, text: str
) -> None:
    file = tmp_path / "numbers.JSON"
    file.write_text(text)
    run = cli("plan", MUG, option, file, "--out", tmp_path / "plan.h5", "--no-picture")
    assert run.code == 2
    assert "NaN" in run.err
    assert not (tmp_path / "plan.h5").exists()
