"""Every command on a full disk, in a folder that cannot be written, and beside another of itself.

`COMMANDS` names each command that writes, with inputs that are good; a new command without a line
here fails `test_no_command_is_left_out`.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
import pytest
import trimesh
import typer.main

from pointsdf_cli.cli.app import app_of

REPOSITORY = Path(__file__).resolve().parents[1]
MUG = REPOSITORY / "assets" / "clouds" / "mug.ply"
CAPTURE = REPOSITORY / "assets" / "captures" / "mustard"
WEIGHTS = REPOSITORY / "assets" / "weights" / "pointsdf_ray"

# Words that begin with @ are files below the folder of good inputs; OUT is where to write.
COMMANDS = {
    "objects make": ["objects", "make", "--out", "OUT", "--count", 2, "--jobs", 1],
    "render": ["render", "--meshes", "@meshes", "--out", "OUT", "--views", 30, "--jobs", 1],
    "label-sdf": [
        "label-sdf", "--views", "@views", "--meshes", "@meshes", "--out", "OUT", "--jobs", 1,
        "--points", 5000,
    ],
    "train-sdf": [
        "train-sdf", "--views", "@views", "--labels", "@labels", "--out", "OUT", "--pack", "@pack",
        "--steps", 1, "--batch-size", 2, "--queries", 8, "--held-out", 0.5, "--threads", 1,
    ],
    "train-sdf, packing": [
        "train-sdf", "--views", "@views", "--labels", "@labels", "--out", "OUT/ckpt",
        "--pack", "OUT/pack", "--steps", 1, "--held-out", 0.5, "--threads", 1,
    ],
    "collect-grasps": [
        "collect-grasps", "--meshes", "@meshes", "--pattern", "box*", "--out", "OUT", "--count", 1,
        "--jobs", 1, "--no-pictures",
    ],
    "mesh": ["mesh", MUG, "--out", "OUT/mug.ply", "--resolution", 32, "--threads", 1],
    "eval-sdf": [
        "eval-sdf", "--checkpoint", WEIGHTS, "--views", "@views", "--meshes", "@meshes",
        "--out", "OUT/table.json", "--count", 1, "--resolution", 32, "--samples", 500, "--jobs", 1,
    ],
    "cloud": [
        "cloud", CAPTURE / "depth.png", "--intrinsics", CAPTURE / "K.json",
        "--depth-scale", 0.0001, "--out", "OUT/cloud.ply",
    ],
    "trial": [
        "trial", "--meshes", "@meshes", "--pattern", "box*", "--out", "OUT", "--yaws", 1,
        "--cameras", "high", "--jobs", 1, "--pictures", 0,
    ],
    "report": ["report", "@", "--out", "OUT/report.html"],
}  # fmt: skip
SLOW = {
    # Written through the same functions (`write_artifact`, `write_checkpoint`, `require_folder`),
    # but seconds of simulation or training away; see also the tests of each.
    "train-gs", "eval-gs", "plan",
}  # fmt: skip
WRITES_NOTHING = {"info", "doctor", "serve"}
OTHERS = {"objects fetch", "view", "segment", "calibrate", "robot check", "robot init"}
"""Tested beside what they do: tests/test_objects_fetch.py, tests/test_cli_*.py."""


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two meshes with views, labels and a pack."""
    folder = tmp_path_factory.mktemp("good")
    (folder / "meshes").mkdir()
    trimesh.creation.box((0.08, 0.06, 0.04)).export(folder / "meshes" / "box.ply")
    trimesh.creation.icosphere(3, 0.05).export(folder / "meshes" / "ball.ply")
    stages = (
        ["render", "--meshes", "@meshes", "--out", "@views", "--views", 3],
        ["label-sdf", "--views", "@views", "--meshes", "@meshes", "--out", "@labels"],
    )
    for stage in stages:
        assert rgrasp([*stage, "--jobs", 1, "--quiet"], folder, folder).returncode == 0
    made = rgrasp([*COMMANDS["train-sdf"], "--quiet"], folder, folder / "ckpt")
    assert made.returncode == 0, made.stderr
    return folder


def rgrasp(
    words: Sequence[object], good: Path, out: Path, before: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run a command of `COMMANDS` in a process of its own, after the Python lines `before`."""
    arguments = [
        str(good / word[1:]) if isinstance(word, str) and word.startswith("@")
        else str(word).replace("OUT", str(out))
        for word in words
    ]  # fmt: skip
    code = f"{before}\nimport sys\nsys.argv[0] = 'rgrasp'\n" + (
        "from pointsdf_cli.cli.main import main\nmain()\n"
    )
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env={**os.environ, "OMP_NUM_THREADS": "1", "MPLCONFIGDIR": str(good / ".matplotlib")},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_no_command_is_left_out() -> None:
    root = typer.main.get_command(app_of())
    names = set()
    for name, command in root.commands.items():  # type: ignore[attr-defined]
        inner = getattr(command, "commands", None)
        names |= {f"{name} {sub}" for sub in inner} if inner else {name}
    assert names - set(COMMANDS) - SLOW - WRITES_NOTHING - OTHERS == set()


@pytest.mark.skipif(sys.platform != "linux", reason="limits file sizes through prlimit")
@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_is_one_message_and_leaves_nothing(
    name: str, good: Path, tmp_path: Path
) -> None:
    # A limit on file size fails a write as a full disk does, without filling one.
    limit = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (900, 900))"
    done = rgrasp(COMMANDS[name], good, tmp_path / "out", limit)
    assert done.returncode in (1, 2), (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr, done.stderr
    assert "rgrasp: " in done.stderr
    assert "rgrasp: the output cannot" not in done.stderr, "nothing was printed yet"
    assert files(tmp_path / "out") == []


@pytest.mark.parametrize("name", COMMANDS)
def test_a_folder_that_cannot_be_written_is_one_message(
    name: str, good: Path, tmp_path: Path
) -> None:
    # /proc refuses everyone, root too, to whom permissions mean nothing.
    done = rgrasp(COMMANDS[name], good, Path("/proc/rgrasp"))
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr, done.stderr
    assert "/proc/rgrasp" in done.stderr


def test_two_processes_on_one_folder_do_not_spoil_it(good: Path, tmp_path: Path) -> None:
    words = [
        "render", "--meshes", str(good / "meshes"), "--views", "20", "--jobs", "1", "--quiet",
    ]  # fmt: skip
    start = [sys.executable, "-m", "pointsdf_cli.cli.main", *words]
    alone = tmp_path / "alone"
    assert subprocess.run([*start, "--out", alone], check=False).returncode == 0
    both = [subprocess.Popen([*start, "--out", tmp_path / "both"]) for _ in range(2)]
    assert [process.wait(timeout=120) for process in both] == [0, 0]
    assert sorted(p.name for p in files(tmp_path / "both")) == ["ball.h5", "box.h5"]
    for name in ("ball.h5", "box.h5"):
        with h5py.File(alone / name) as one, h5py.File(tmp_path / "both" / name) as other:
            np.testing.assert_array_equal(one["cloud"], other["cloud"])
