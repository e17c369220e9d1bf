"""Input that looks right and is not, or looks wrong and is right: each is told apart."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import run_cli
from PIL import Image
from test_cli_mesh import constant_network, saved

from pointsdf_cli.assets import asset_path
from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.camera.intrinsics import read_intrinsics
from pointsdf_cli.camera.pinhole import CAMERAS, Camera
from pointsdf_cli.camera.scene_file import is_depth_image
from pointsdf_cli.camera.segmentation import SegmentationConfig
from pointsdf_cli.camera.table_objects import TableObjects, add_masked_object
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.apart import require_apart
from pointsdf_cli.io.board_images import match_poses
from pointsdf_cli.io.checkpoints import require_checkpoint_place
from pointsdf_cli.io.depth_images import read_mask
from pointsdf_cli.io.hdf5 import OptionsDifferError, is_complete, write_artifact
from pointsdf_cli.io.poses import camera_pose, target_numbers
from pointsdf_cli.trials import protocol

K = [[600.0, 0.0, 320.0], [0.0, 610.0, 240.0], [0.0, 0.0, 1.0]]
TABLE = asset_path("clouds/table.ply")


# --- files of the user ---------------------------------------------------------------------------


def test_a_record_of_something_else_is_kept(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "full", -0.1)
    cloud = saved(tmp_path)
    annotation = tmp_path / "cloud.json"
    annotation.write_text('{"label": "can"}')
    words = ["mesh", cloud, "--each", "--out", tmp_path, "--checkpoint", weights, "--format", "obj"]
    run = run_cli(*words, "--resolution", 32, "--jobs", 1)
    assert run.code == 2
    assert "cloud.json: is no record of cloud.obj" in run.err
    assert annotation.read_text() == '{"label": "can"}'
    assert not (tmp_path / "cloud.obj").exists()
    assert run_cli(*words, "--resolution", 32, "--jobs", 1, "--force").code == 0


def test_a_photograph_beside_a_cloud_is_kept(tmp_path: Path) -> None:
    scene = tmp_path / "a.ply"
    scene.write_bytes(TABLE.read_bytes())
    Image.new("RGB", (4, 4)).save(tmp_path / "a.png")
    before = (tmp_path / "a.png").read_bytes()
    run = run_cli("plan", scene, "--each", "--out", tmp_path, "--jobs", 1)
    assert run.code == 2
    assert "a.png: exists already" in run.err
    assert (tmp_path / "a.png").read_bytes() == before
    assert not (tmp_path / "a.h5").exists()


def test_a_numbered_mask_is_an_input(tmp_path: Path) -> None:
    mask = tmp_path / "labels.png"
    mask.write_bytes(b"")
    with pytest.raises(InputError, match="is an input"):
        require_apart([mask], [f"{mask}:7"])
    require_apart([mask], [f"{tmp_path / 'other.png'}:7"])


def test_a_linked_mesh_stays_a_link(tmp_path: Path) -> None:
    weights = constant_network(tmp_path / "full", -0.1)
    out, target = tmp_path / "out", tmp_path / "elsewhere.ply"
    out.mkdir()
    target.write_text("an old mesh")
    (out / "cloud.ply").symlink_to(target)
    words = ["mesh", saved(tmp_path), "--each", "--out", out, "--checkpoint", weights]
    assert run_cli(*words, "--resolution", 32, "--jobs", 1, "--force").code == 0
    assert (out / "cloud.ply").is_symlink()
    assert target.read_bytes().startswith(b"ply")
    kept = target.stat().st_mtime_ns
    assert run_cli(*words, "--resolution", 32, "--jobs", 1).code == 0
    assert target.stat().st_mtime_ns == kept


def test_a_link_to_itself_or_to_nowhere_is_one_message(tmp_path: Path) -> None:
    loop, lost = tmp_path / "loop.h5", tmp_path / "lost.h5"
    loop.symlink_to(loop)
    lost.symlink_to("/proc/nowhere/plan.h5")
    for out, what in ((loop, "leads to itself"), (lost, "/proc/nowhere")):
        run = run_cli("plan", TABLE, "--out", out)
        assert run.code == 2
        assert what in run.err
        assert "Traceback" not in run.err
    with pytest.raises(InputError):
        require_checkpoint_place(loop, replace=False)


# --- masks ---------------------------------------------------------------------------------------


def test_the_numbers_of_a_palette_are_labels_255_too(tmp_path: Path) -> None:
    values = np.zeros((4, 6), np.uint8)
    values[0], values[1], values[2] = 1, 5, 255
    image = Image.fromarray(values, mode="P")
    image.putpalette(list(range(256)) * 3)
    image.save(tmp_path / "labels.png")
    with pytest.raises(InputError, match="3 numbers"):
        read_mask(str(tmp_path / "labels.png"))
    assert read_mask(f"{tmp_path / 'labels.png'}:5").sum() == 6
    Image.fromarray(values).save(tmp_path / "soft.png")  # a mask with soft edges
    assert read_mask(str(tmp_path / "soft.png")).sum() == 18


@pytest.mark.parametrize("beside", [-1.0, np.nan])
def test_what_is_not_0_beside_the_object_is_refused(beside: float, tmp_path: Path) -> None:
    values = np.full((4, 6), beside, np.float32)
    values[1:3, 2:4] = 0
    np.save(tmp_path / "mask.npy", values)
    with pytest.raises(InputError, match="0 beside the object"):
        read_mask(str(tmp_path / "mask.npy"))


def test_a_masked_part_of_a_cut_object_is_cut() -> None:
    label = np.repeat([0, 1], 100)
    found = TableObjects(label, None, unsplit=frozenset({1}), cut=frozenset({0}))
    mask = np.arange(200) < 90
    added = add_masked_object(mask, found)
    assert added.cut == {0, 2}
    assert added.unsplit == {1}
    assert add_masked_object(~mask & (label == 1), found).cut == {0}


# --- depth and intrinsics ------------------------------------------------------------------------


def test_every_fitting_unit_of_depth_is_named() -> None:
    camera = CAMERAS["realsense"]
    tum = np.full((480, 640), 4.0)  # of 0.8 m, in 1/5000 m
    tum[:240] = 6.0
    with pytest.raises(InputError) as told:
        cloud_of_depth(tum, camera, nearest=0.1, farthest=2.5, scale=0.001)
    for scale in ("0.0001 (0.4 to 0.6 m)", "0.0002 (0.8 to 1.2 m)", "0.00025 (1 to 1.5 m)"):
        assert f"--depth-scale {scale}" in str(told.value.hint)
    with pytest.raises(InputError, match="check --depth-scale"):
        cloud_of_depth(tum, camera, nearest=0.1, farthest=2.5)
    assert "rgrasp cloud --far" in str(told.value.hint)


@pytest.mark.parametrize("name", ["K.txt", "K.csv", "K.npy"])
def test_a_matrix_in_rows_is_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if name == "K.npy":
        np.save(path, np.array(K))
    else:
        np.savetxt(path, np.array(K), delimiter="," if name == "K.csv" else " ")
    assert read_intrinsics(str(path), 640, 480) == Camera(640, 480, 600.0, 610.0, 320.0, 240.0)


def test_intrinsics_as_shares_of_the_image_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "K.json"
    path.write_text(json.dumps({"fx": 0.9, "fy": 1.2, "cx": 0.5, "cy": 0.5}))
    with pytest.raises(InputError, match="shares of the image"):
        read_intrinsics(str(path), 640, 480)


def test_a_depth_array_with_one_more_axis_is_no_cloud(tmp_path: Path) -> None:
    for shape, is_image in (((1, 24, 32), True), ((24, 32), True), ((24, 32, 3), False)):
        np.save(tmp_path / "a.npy", np.ones(shape))
        assert is_depth_image(tmp_path / "a.npy", "K.json") is is_image


# --- numbers -------------------------------------------------------------------------------------


def test_a_quaternion_of_another_length_is_refused() -> None:
    with pytest.raises(InputError, match=r"length 5\.07"):
        camera_pose("0.6,0,0.7,0.5,-0.5,-0.5,5")
    assert camera_pose("0,0,1,0.71,0.71,0,0")[2, 3] == 1.0  # two decimals are enough


def test_numbers_are_numbers_beside_a_folder_of_this_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "1").mkdir()
    monkeypatch.chdir(tmp_path)
    assert target_numbers("1").tolist() == [1]


def test_a_missing_file_with_a_blank_in_its_path_is_missing() -> None:
    with pytest.raises(InputError, match="no such file"):
        camera_pose("my folder/pose.json")


def test_a_workspace_is_no_hall() -> None:
    with pytest.raises(InputError, match="workspace of 210000"):
        SegmentationConfig((-50.0, -50.0, -1.0), (50.0, 50.0, 20.0))


def test_names_may_have_blanks_around_them() -> None:
    run = run_cli("trial", "--cameras", ",")
    assert run.code == 2
    assert "no camera is given" in run.err
    two = protocol.choose_objects(None, "mustard, lego")
    assert [one.name for one in two] == ["mustard", "lego"]


# --- messages ------------------------------------------------------------------------------------


def test_only_the_changed_setting_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    config = {"planner": {"margin": 0.001, "rounds": 5, "weights": list(range(50))}}
    write_artifact(path, "test", 1, layout={}, arrays={}, seed=0, config=config)
    changed = {"planner": {**config["planner"], "margin": 0.002}}
    with pytest.raises(OptionsDifferError) as told:
        is_complete(path, schema="test", version=1, config=changed)
    assert "planner.margin: 0.001 there, 0.002 now" in str(told.value)
    assert "rounds" not in str(told.value)


def test_the_cloud_behind_the_camera_is_named(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform([-0.1, -0.1, -0.9], [0.1, 0.1, -0.7], (300, 3))
    cloud = tmp_path / "behind.xyz"
    np.savetxt(cloud, points)
    run = run_cli(
        "plan", TABLE, cloud, "--camera-pose", "0,0,1,0,1,0,0", "--camera-pose", "0,0,1,0,1,0,0"
    )
    assert run.code == 2
    assert "behind.xyz" in run.err


def test_options_of_bags_are_named(tmp_path: Path) -> None:
    Image.fromarray(np.full((48, 64), 800, np.uint16)).save(tmp_path / "depth.png")
    run = run_cli("cloud", tmp_path / "depth.png", "--intrinsics", "realsense", "--frames", 3)
    assert run.code == 2
    assert "--frames are for bags" in run.err


@dataclass(frozen=True)
class _Image:
    name: str

    @property
    def stem(self) -> str:
        return os.path.splitext(self.name)[0]


def test_two_images_do_not_share_a_pose() -> None:
    images = [_Image("a.png"), _Image("a.jpg")]
    with pytest.raises(InputError, match=r"one pose for a\.png, a\.jpg"):
        match_poses(images, ["a", "b"], 2, "poses.json")  # type: ignore[arg-type]
    assert match_poses(images, ["a.jpg", "a.png"], 2, "poses.json") == [1, 0]  # type: ignore[arg-type]
