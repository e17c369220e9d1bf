"""`rgrasp mesh` as a user runs it, with a network whose answer is known: "inside" everywhere.

Its surface is the whole box of the network's frame: ±0.8 about the centre of the cloud's bounding
box, in units of 1.03 times the cloud's largest extent, less half a cell on each side.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from conftest import run_cli

from pointsdf_cli.assets import asset_path
from pointsdf_cli.geometry.frames import (
    apply_transform,
    invert_transform,
    random_rotation,
    transform,
    wxyz_from_rotation,
)
from pointsdf_cli.io.checkpoints import write_checkpoint
from pointsdf_cli.io.clouds import Cloud, write_cloud
from pointsdf_cli.io.ply import ply_comments
from pointsdf_cli.io.raw_cloud import pose_of_header
from pointsdf_cli.models.registry import build_model

RESOLUTION = 32
RNG = np.random.default_rng(0)
POINTS = RNG.uniform([-0.06, -0.04, 0.7], [0.05, 0.03, 0.78], (300, 3)).astype("f4").astype("f8")
POSE = transform(random_rotation(RNG), [0.4, -0.3, 1.2])


def constant_network(folder: Path, value: float) -> Path:
    """A checkpoint of the default architecture, small, that says `value` of every point."""
    model = build_model(
        "pointsdf-ray",
        {
            "centres": [32, 16, 8, 4],
            "neighbours": [8, 8, 8, 4],
            "hidden": [8, 8, 8, 8],
            "channels": [8, 8, 8, 8],
            "width": 16,
            "blocks": 1,
            "local": 8,
            "heads": 1,
        },
    )
    with torch.no_grad():
        model.leave.weight.zero_()
        model.leave.bias.fill_(value)
    write_checkpoint(
        folder,
        config={"architecture": "pointsdf-ray", "model": model.config()},
        weights=model.state_dict(),
    )
    return folder


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return constant_network(tmp_path_factory.mktemp("full"), -0.1)


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return constant_network(tmp_path_factory.mktemp("empty"), 0.1)


def box_about(points: np.ndarray) -> np.ndarray:
    """The corners [2, 3] of the box that the full network fills."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = (0.8 - 0.8 / RESOLUTION) * 1.03 * (high - low).max()
    return (low + high) / 2 + np.array([[-half], [half]])


def mesh(
    cloud: Path, checkpoint: Path, *options: object, quiet: bool = True
) -> tuple[int, str, str]:
    # Unsmoothed, because the box that these networks fill has corners that are known exactly.
    result = run_cli(
        "mesh", cloud, "--checkpoint", checkpoint, "--resolution", RESOLUTION, "--threads", 1,
        "--smooth", 0, *["--quiet"] * quiet, *options,
    )  # fmt: skip
    return result.code, result.out, result.err


def saved(folder: Path, points: np.ndarray = POINTS, **about: object) -> Path:
    write_cloud(folder / "cloud.ply", Cloud(points, **about))
    return folder / "cloud.ply"


@pytest.mark.parametrize("form", ["ply", "obj", "stl", "glb"])
def test_fills_the_box_in_every_format(form: str, full: Path, tmp_path: Path) -> None:
    out = tmp_path / f"mesh.{form}"
    code, _, err = mesh(saved(tmp_path), full, "--out", out)
    assert (code, err) == (0, "")
    made = trimesh.load(out, force="mesh")
    made.merge_vertices()
    assert made.is_watertight
    assert made.volume > 0
    assert made.bounds == pytest.approx(box_about(POINTS), abs=1e-6)


def test_a_world_cloud_gives_a_mesh_in_the_world(full: Path, tmp_path: Path) -> None:
    world = apply_transform(POSE, POINTS)
    out = tmp_path / "mesh.ply"
    assert (
        mesh(saved(tmp_path, world, frame="world", T_world_camera=POSE), full, "--out", out)[0] == 0
    )
    made = trimesh.load(out)
    assert ply_comments(out)["frame"] == "world"
    in_camera = apply_transform(invert_transform(POSE), made.vertices)
    assert np.array([in_camera.min(0), in_camera.max(0)]) == pytest.approx(
        box_about(POINTS), abs=2e-6
    )


def test_the_pose_may_be_typed(full: Path, tmp_path: Path) -> None:
    world = apply_transform(POSE, POINTS)
    typed = ",".join(map(repr, [*POSE[:3, 3].tolist(), *wxyz_from_rotation(POSE[:3, :3]).tolist()]))
    cloud = saved(tmp_path, world)
    out = tmp_path / "mesh.ply"
    code, _, err = mesh(cloud, full, "--out", out, "--frame", "world", f"--camera-pose={typed}")
    assert code == 0, err
    in_camera = apply_transform(invert_transform(POSE), trimesh.load(out).vertices)
    assert in_camera.min(0) == pytest.approx(box_about(POINTS)[0], abs=2e-6)


@pytest.mark.parametrize("each", [(), ("--each",)])
def test_a_meshes_header_says_where_it_lies(
    each: tuple[str, ...], full: Path, tmp_path: Path
) -> None:
    cloud = saved(tmp_path, POINTS, T_world_camera=POSE)
    made = tmp_path / "made" / cloud.name
    code, _, err = mesh(cloud, full, *each, "--out", made.parent if each else made)
    assert code == 0, err
    comments = ply_comments(made)
    assert comments["frame"] == "camera"
    assert pose_of_header(comments, made) == pytest.approx(POSE, abs=1e-12)


def test_millimetres_in_millimetres_out(full: Path, tmp_path: Path) -> None:
    cloud = saved(tmp_path, POINTS * 1000)
    out = tmp_path / "mesh.ply"
    code, _, err = mesh(cloud, full, "--out", out)
    assert code == 2
    assert "--unit mm" in err
    assert mesh(cloud, full, "--out", out, "--unit", "mm")[0] == 0
    assert trimesh.load(out).bounds == pytest.approx(1000 * box_about(POINTS), abs=1e-3)


def test_normals_colours_and_many_points_do_not_disturb(full: Path, tmp_path: Path) -> None:
    many = np.tile(POINTS, (3000, 1))
    normals = np.tile([0.0, 0.0, -1.0], (len(many), 1))
    cloud = saved(tmp_path, many, normals=normals, colours=np.zeros(many.shape, np.uint8))
    code, out, _ = mesh(cloud, full, "--out", tmp_path / "mesh.stl", "--json")
    told = json.loads(out)
    assert code == 0
    assert 250 <= told["points"] <= 300  # of one place one point is enough
    box = box_about(POINTS)
    assert np.array(told["extent"]) == pytest.approx(box[1] - box[0], rel=0.05)
    assert told["queries"] > 0
    assert not told["vessel"]


def test_a_fitted_wall_is_named(tmp_path: Path) -> None:
    cloud, weights = asset_path("clouds/mug.ply"), asset_path("weights/pointsdf_real")
    code, out, err = mesh(cloud, weights, "--out", tmp_path / "mug.ply", quiet=False)
    assert code == 0, err
    assert "; the thin wall of a vessel is fitted" in out + err


def test_nothing_inside_is_one_message_and_no_file(empty: Path, tmp_path: Path) -> None:
    out = tmp_path / "mesh.ply"
    code, _, err = mesh(saved(tmp_path), empty, "--out", out)
    assert code == 1
    assert "nothing solid" in err
    assert not out.exists()


LINE = np.outer(np.linspace(0, 0.1, 100), [1, 2, 3]) + [0, 0, 1]
BAD = {
    "three points": (POINTS[:3], "too few"),
    "all equal": (np.repeat(POINTS[:1], 80, axis=0), "same point"),
    "a line": (LINE, "one line"),
    "not numbers": (np.where(np.arange(300)[:, None] == 5, np.nan, POINTS), "--drop-invalid"),
    "a room": (RNG.uniform([-2, -1, 1], [2, 1, 4], (500, 3)), "whole scene"),
    "behind the camera": (POINTS - [0, 0, 2], "behind the camera"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_cloud_is_one_message(name: str, full: Path, tmp_path: Path) -> None:
    points, message = BAD[name]
    code, out, err = mesh(saved(tmp_path, points), full, "--out", tmp_path / "mesh.ply")
    assert (code, out) == (2, "")
    assert message in err
    assert err.startswith("rgrasp: ")
    assert len(err.splitlines()) <= 3
    assert not (tmp_path / "mesh.ply").exists()


def test_holes_are_left_out_where_asked(full: Path, tmp_path: Path) -> None:
    cloud = saved(tmp_path, BAD["not numbers"][0])
    assert mesh(cloud, full, "--out", tmp_path / "mesh.ply", "--drop-invalid")[0] == 0


def test_a_plane_is_no_mistake(full: Path, tmp_path: Path) -> None:
    flat = POINTS * [1, 1, 0] + [0, 0, 0.7]
    assert mesh(saved(tmp_path, flat), full, "--out", tmp_path / "mesh.ply")[0] == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--resolution", 100], "32, 64, 128, 256, 512"),
        (["--format", "dae"], "ply, obj, stl, glb"),
        (["--format", "obj", "--out", "x.ply"], "disagree"),
        (["--frame", "moon"], "camera, world"),
        (["--frame", "world"], "--camera-pose"),
        (["--camera-pose", "1,2,3"], "not a pose"),
        (["--camera-pose", "9,0,1,0,9,1,0,0,1"], "are they intrinsics?"),
        (["--camera-pose", "1,2,3,0,0,0,0"], "the quaternion is 0"),
        (["--unit", "furlong"], "m, cm, mm, inch"),
        (["--device", "abacus"], "cpu, cuda"),
        (["--format", "ply", "--out", "."], "mesh.ply"),
    ],
)
def test_a_wrong_option_is_one_message(
    options: list[object], message: str, full: Path, tmp_path: Path
) -> None:
    code, _, err = mesh(saved(tmp_path), full, "--out", tmp_path / "mesh.ply", *options)
    assert code == 2
    assert message in err
    assert "Traceback" not in err


def test_nothing_is_overwritten_unasked(full: Path, tmp_path: Path) -> None:
    out = tmp_path / "mesh.ply"
    out.write_text("mine")
    code, _, err = mesh(saved(tmp_path), full, "--out", out)
    assert code == 2
    assert "--force" in err
    assert out.read_text() == "mine"
    assert mesh(saved(tmp_path), full, "--out", out, "--force")[0] == 0


def test_a_name_with_dollars_is_drawn_as_it_is(full: Path, tmp_path: Path) -> None:
    named = tmp_path / "mug_$5_to_$9.ply"
    named.write_bytes((TABLE.parent / "mug.ply").read_bytes())
    picture = tmp_path / "look.png"
    code, _, err = mesh(
        named, full, "--out", tmp_path / "m.ply", "--resolution", 32, "--picture", picture
    )
    assert code == 0, err
    assert picture.read_bytes()[:4] == b"\x89PNG"


TABLE = Path(__file__).resolve().parents[1] / "assets" / "clouds" / "table.ply"


def test_a_whole_table_is_pointed_out_and_the_object_cut_out_of_it(
    full: Path, tmp_path: Path
) -> None:
    code, _, err = mesh(TABLE, full, "--out", tmp_path / "all.ply", quiet=False)
    assert code == 0
    assert "--segment auto" in err
    sizes = []
    for name, options in (("largest", ()), ("mug", ("--target", "0.62,0.28,0.05"))):
        out = tmp_path / f"{name}.ply"
        code, _, err = mesh(TABLE, full, "--segment", "auto", *options, "--out", out, quiet=False)
        assert code == 0, err
        assert "on the table" in err
        sizes.append(trimesh.load(out).extents)
    # The network fills its box: 1.6 times the seen extent, and nothing here is wider than 20 cm.
    assert max(size.max() for size in sizes) < 1.6 * 1.03 * 0.2
    assert not np.allclose(*sizes)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--segment", "auto", "--target", "3,0,0"), "away from it"),
        (("--segment", "auto", "--target", "3,0"), "--target"),
        (("--segment", "yes"), "auto, none"),
        (("--target", "0.6,0,0"), "--segment auto"),
        (("--workspace", "0,-1,0,1,1,1"), "--segment auto"),
        (("--segment", "auto", "--workspace", "3,3,0,4,4,1"), "between (3.0, 3.0, 0.0)"),
    ],
)
def test_what_cannot_be_cut_out_is_one_message(
    options: tuple[str, ...], told: str, full: Path, tmp_path: Path
) -> None:
    code, _, err = mesh(TABLE, full, *options, "--out", tmp_path / "m.ply")
    assert code == 2
    assert told in err
    assert not (tmp_path / "m.ply").exists()


def test_a_mesh_that_misses_its_cloud_is_said(full: Path, tmp_path: Path) -> None:
    # The full network's box is 1.6 times as large as the cloud on each side.
    for options in ((), ("--each", "--jobs", 1)):
        out = tmp_path / ("meshes" if options else "mesh.ply")
        code, told, err = mesh(saved(tmp_path), full, "--out", out, *options, quiet=False)
        assert code == 0
        assert "warning: the reconstruction misses" in told + err
    (one,) = json.loads((tmp_path / "meshes/cloud.json").read_text())["warnings"]
    assert "whose frame is not the camera's" in one
