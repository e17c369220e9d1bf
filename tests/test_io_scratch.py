"""Folders of temporary files: private, gone with their process, and tidied where it was killed."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from pointsdf_cli.io.scratch import Scratch
from pointsdf_cli.robot.description import load_robot

KILLED = """
import os, signal, sys
from pathlib import Path
from pointsdf_cli.io.scratch import Scratch
folder = Scratch(Path(sys.argv[1]))
(folder.path / "x").write_text("x")
os.kill(os.getpid(), signal.SIGKILL if sys.argv[2] == "kill" else 0)
"""


def run(below: Path, how: str) -> None:
    subprocess.run([sys.executable, "-c", KILLED, str(below), how], check=False)


def test_a_folder_is_its_owners_and_ends_with_the_process(tmp_path: Path) -> None:
    with Scratch(tmp_path) as folder:
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        (folder / "x").write_text("x")
    run(tmp_path, "end")
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_process_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    run(tmp_path, "kill")
    (left,) = tmp_path.iterdir()
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "x").write_text("x")
    link = tmp_path / re.sub(r"partial-.{8}", "partial-0123abcd", left.name)
    link.symlink_to(precious)
    with Scratch(tmp_path) as alive, Scratch(tmp_path) as another:
        assert {p.name for p in tmp_path.iterdir()} == {
            "precious", link.name, alive.name, another.name,
        }  # fmt: skip
    assert (precious / "x").exists()


def test_the_simulator_leaves_nothing_after_a_kill(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    code = (
        "import os, signal\nfrom pointsdf_cli.robot.description import load_robot\n"
        "from pointsdf_cli.simulation.world import World\nworld = World(load_robot())\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, "TMPDIR": str(tmp_path)}, check=False
    )
    assert len(list(tmp_path.iterdir())) == 1
    from pointsdf_cli.simulation.world import World

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    World(load_robot()).close()
    assert list(tmp_path.iterdir()) == []
