"""What a command need not import, it does not: mistakes are told before heavy libraries load."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import h5py
import pytest

from pointsdf_cli.assets import asset_path

TABLE = str(asset_path("clouds/table.ply"))
SUCCESS = str(asset_path("weights/grasp_geometry"))
RECONSTRUCTION = str(asset_path("weights/pointsdf_real"))
HEAVY = ("torch", "open3d", "trimesh", "matplotlib", "cvxpy", "pybullet")

RUN = """
import sys
from pointsdf_cli.cli.main import main
sys.argv = ["rgrasp", *sys.argv[1:]]
try:
    main()
except SystemExit as leave:
    print("code", leave.code)
print("loaded", *(name for name in {heavy} if name in sys.modules))
"""


def run(code: str, *words: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    "words",
    [
        ["plan", TABLE, "--robot", "none.yaml"],
        ["plan", TABLE, "--start", "1,2,3"],
        ["plan", TABLE, "--method", "guess"],
        ["plan", TABLE, "--margin", "1"],
        ["plan", TABLE, "--checkpoint", "none"],
        ["plan", TABLE, "--device", "abacus"],
        ["plan", TABLE, "--environment", "none.yaml"],
        ["plan", "{}/lost.xyz"],
        ["plan", "{}/millimetres.xyz", "--camera-pose", "0,0,1,0,1,0,0"],
        ["plan", TABLE, "--server", "nowhere"],
        ["mesh", TABLE, "--checkpoint", "none"],
        ["serve", "--port", "70000"],
        ["serve", "--robot", "none.yaml"],
        ["robot", "check", "none.yaml"],
        ["trial", "--robot", "none.yaml"],
        ["trial", "--meshes", "none"],
        ["train-sdf", "--views", "none", "--labels", "none", "--out", "{}/c"],
        [
            "train-gs",
            "--grasps",
            "none",
            "--encoder",
            "pointsdf",
            "--mode",
            "fixed",
            "--out",
            "{}/c",
        ],
        ["eval-gs", "--grasps", "none", "--checkpoint", "none", "--out", "{}/t.json"],
        ["eval-sdf", "--checkpoint", "none", "--views", "none", "--meshes", "none"],
        ["collect-grasps", "--meshes", "none", "--out", "{}/g"],
        ["render", "--meshes", "none", "--out", "{}/v"],
        ["label-sdf", "--views", "none", "--meshes", "none", "--out", "{}/l"],
        ["view", "none.h5"],
        ["report", "none"],
        ["info", "none.h5"],
        ["segment", "none.ply"],
        ["mesh", "none.ply"],
        ["cloud", "none.png", "--intrinsics", "kinect2"],
        ["plan", TABLE, "--checkpoint", SUCCESS],
        ["plan", TABLE, "--grasp-checkpoint", RECONSTRUCTION],
        ["plan", TABLE, "--grasp-checkpoint", SUCCESS, "--robot", "panda"],
        ["mesh", TABLE, "--checkpoint", SUCCESS],
        ["serve", "--grasp-checkpoint", RECONSTRUCTION],
        ["trial", "--yaws", "0"],
        ["trial", "--clutter", "2", "--shake", "5"],
        ["trial", "--ablation", "guess"],
        ["trial", "--ablation", "checkpoint=none"],
        ["trial", "--objects", "nothing"],
        ["trial", "--meshes", "{}"],
        ["trial", "--hold", "-1"],
        ["train-sdf", "--views", "{}", "--labels", "{}", "--out", "{}/c", "--minutes", "-1"],
        ["train-sdf", "--views", "{}/views", "--labels", "{}/views", "--out", "{}/c"],
        ["train-gs", "--grasps", "{}", "--out", "{}/c"],
        ["train-gs", "--grasps", "{}/views", "--out", "{}/c"],
        ["eval-gs", "--grasps", "{}/views", "--checkpoint", SUCCESS, "--out", "{}/t.json"],
        ["eval-sdf", "--checkpoint", SUCCESS, "--views", "{}/views", "--meshes", TABLE],
        ["eval-sdf", "--checkpoint", RECONSTRUCTION, "--views", "{}/views", "--meshes", "{}"],
        ["collect-grasps", "--meshes", TABLE, "--count", "0", "--out", "{}/g"],
        ["collect-grasps", "--meshes", TABLE, "--checkpoint", RECONSTRUCTION, "--out", "{}/g"],
        ["view", "{}"],
        ["view", TABLE, "--port", "70000"],
        ["view", TABLE, "--export", "page.txt"],
        ["calibrate", "none", "--intrinsics", "kinect2", "--robot-poses", "none.json"],
    ],
)
def test_a_mistake_is_told_before_anything_heavy_loads(words: list[str], tmp_path: Path) -> None:
    places = [(k % 10 / 100, k // 10 / 100, 0.8 + k / 1e4) for k in range(99)]
    for name, factor in (("lost", 1), ("millimetres", 1000)):
        lines = [" ".join(f"{factor * value}" for value in place) for place in places]
        (tmp_path / f"{name}.xyz").write_text("\n".join(lines))
    (tmp_path / "views").mkdir()
    with h5py.File(tmp_path / "views" / "mug.h5", "w") as file:
        file.attrs["schema"], file.attrs["schema_version"] = "views", 1
    names = {"plan": "no.h5", "mesh": "no.ply"}
    out = ["--out", str(tmp_path / names[words[0]])] if words[0] in names else []
    code = RUN.replace("{heavy}", repr(HEAVY))
    told = run(code, *(word.format(tmp_path) for word in words), *out)
    assert told[-2:] == ["code 2", "loaded"]


def test_open3d_loads_without_its_notebooks() -> None:
    told = run(
        "import sys\n"
        "from pointsdf_cli.geometry.open3d_core import o3d\n"
        "print('open3d' in sys.modules)\n"
        "print(o3d.t.geometry.RaycastingScene().cast_rays is not None)\n"
        "print(*(name for name in ('dash', 'plotly', 'IPython') if name in sys.modules))\n"
        "import open3d\n"
        "print(open3d.__name__)\n"
    )
    assert told == ["False", "True", "", "open3d"]
