"""No output replaces an input, whatever --force says and however the place is spelt."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from conftest import run_cli
from fuzz.artifacts import ROBOTS, write_artifacts
from PIL import Image

from pointsdf_cli.assets import asset_path
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.apart import require_apart

MUG = Path(__file__).resolve().parents[1] / "assets" / "clouds" / "mug.ply"


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Inputs of every command, and links to two of them."""
    folder = tmp_path_factory.mktemp("given")
    (folder / "m").mkdir()
    trimesh.creation.box((0.08, 0.06, 0.04)).export(folder / "m" / "box.ply")
    made = ("render", "--meshes", folder / "m", "--out", folder / "v", "--views", 2, "-j", 1)
    assert run_cli(*made, "-q").code == 0
    (folder / "g").mkdir()
    write_artifacts(folder / "g", np.random.default_rng(0).normal(0, 0.03, (60, 3)))
    for name in ("labels", "grasps"):
        (folder / name).mkdir()
        shutil.copy(folder / "g" / f"{name}.h5", folder / name)
    shutil.copytree(asset_path("weights/voxelcnn"), folder / "ckpt")
    shutil.copytree(asset_path("weights/grasp_geometry"), folder / "success")
    shutil.copytree(ROBOTS, folder / "robot")
    shutil.copy(MUG, folder / "mug.ply")
    os.link(folder / "mug.ply", folder / "other.ply")
    (folder / "link").symlink_to("v")
    Image.fromarray(np.full((48, 64), 800, np.uint16)).save(folder / "depth.png")
    (folder / "K.json").write_text("[60, 0, 32, 0, 60, 24, 0, 0, 1]")
    (folder / "poses.json").write_text("[]")
    return folder


def sums(folder: Path) -> dict[Path, str]:
    return {
        path: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize(
    "command",
    [
        "label-sdf --views v --meshes m --out v",
        "label-sdf --views v --meshes m --out link",
        "label-sdf --views v --meshes m --out m/../v/.",
        "train-sdf --views v --labels labels --out v",
        "train-sdf --views v --labels labels --out new --pack link",
        "train-sdf --views v --labels labels --out ckpt --start-from ckpt",
        "train-gs --grasps grasps --out grasps",
        "train-gs --grasps grasps --out new --cache grasps",
        "train-gs --grasps grasps --out ckpt --sdf ckpt",
        "eval-gs --checkpoint success --grasps grasps --out success/config.json",
        "eval-gs --checkpoint success --grasps grasps --out grasps/grasps.h5",
        "eval-sdf --checkpoint ckpt --views v --meshes m --out ckpt/config.json",
        "eval-sdf --checkpoint ckpt --views v --meshes m --out m/box.ply",
        "mesh mug.ply --out mug.ply",
        "mesh mug.ply --out other.ply",
        "mesh depth.png --intrinsics K.json --picture depth.png",
        "plan mug.ply --out g/plan.h5 --trajectory ckpt/config.json --checkpoint ckpt",
        "plan depth.png --intrinsics K.json --camera-pose table --picture depth.png",
        "plan mug.ply --robot robot/gripper.yaml --trajectory robot/gripper.urdf",
        "segment depth.png --intrinsics K.json --picture depth.png",
        "cloud depth.png --intrinsics K.json --out depth.png",
        "calibrate v --intrinsics K.json --robot-poses poses.json --out K.json",
        "report g/plan.h5 --out g/plan.h5",
        "report g --out g/labels.h5",
        "view g/labels.h5 --export g/labels.h5",
        "robot init robot/gripper.urdf --out robot/gripper.urdf",
    ],
)
def test_an_input_is_no_output(given: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    monkeypatch.chdir(given)
    before = sums(given)
    run = run_cli(*command.split(), "--force")
    assert run.code == 2
    assert "is an input, which the output would replace" in run.err
    assert sums(given) == before


def test_trials_and_grasps_replace_no_mesh(
    given: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    monkeypatch.chdir(tmp_path)
    shutil.copytree(given / "m", "m")
    # A second name of the mesh where the stage would write.
    Path("g").mkdir()
    os.link("m/box.ply", "g/box.h5")
    run = run_cli("collect-grasps", "--meshes", "m", "--out", "g", "--force")
    assert (run.code, "is an input" in run.err) == (2, True)
    Path("t").mkdir()
    os.link("m/box.ply", "t/trials.h5")
    run = run_cli("trial", "--meshes", "m", "--out", "t", "--force")
    assert (run.code, "is an input" in run.err) == (2, True)
    assert Path("m/box.ply").read_bytes() == (given / "m" / "box.ply").read_bytes()


def test_artifacts_may_lie_beside_their_meshes_and_are_made_again(
    cli: Callable[..., Any], mesh_folder: Path
) -> None:
    made = ("render", "--meshes", mesh_folder, "--out", mesh_folder, "--views", 2, "-j", 1, "-q")
    assert cli(*made).code == 0
    assert cli(*made).code == 0
    assert cli(*made, "--force").code == 0
    labels = ("label-sdf", "--views", mesh_folder, "--meshes", mesh_folder, "-j", 1, "-q")
    for _ in range(2):
        assert cli(*labels, "--out", mesh_folder.parent / "l", "--points", 2000).code == 0


def test_what_is_typed_and_no_file_is_no_input(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("x")
    require_apart([tmp_path / "out", None], ["0,0,1", "1 0 0 0 " * 100, None, tmp_path / "no"])
    with pytest.raises(InputError, match="is an input"):
        require_apart([tmp_path / "out"], [str(tmp_path / "out")])
