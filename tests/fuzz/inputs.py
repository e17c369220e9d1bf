"""What is damaged: one small good file of each kind, and the reader that a command gives it to."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import trimesh

from pointsdf_cli.camera.pinhole import load_camera
from pointsdf_cli.io.checkpoints import read_train_state, write_checkpoint
from pointsdf_cli.io.clouds import Cloud, check_object_cloud, read_cloud, write_cloud
from pointsdf_cli.io.describe import describe
from pointsdf_cli.io.grasps import Grasps, GraspsMeta, read_grasps, write_grasps
from pointsdf_cli.io.labels import Labels, read_labels, write_labels
from pointsdf_cli.io.meshes import load_mesh
from pointsdf_cli.io.object_mesh import read_object_about, write_object_mesh
from pointsdf_cli.io.plans import Plan, RejectedSeeds, plan_as_json, read_plan, write_plan
from pointsdf_cli.io.poses import camera_pose
from pointsdf_cli.io.views import Views, read_views, read_views_header, write_views
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.objects.archive import extract_mesh
from pointsdf_cli.planning.environment import read_environment
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.urdf import read_urdf

ROBOTS = Path(__file__).resolve().parents[1] / "robots"


class Input(NamedTuple):
    """A kind of file.

    Attributes:
        name: Its file name, with a folder where its neighbours matter.
        read: What is done with it; may raise InputError and nothing else.
        share: How often it is taken; slow readers less often.
    """

    name: str
    read: Callable[[Path], object]
    share: float = 1.0


def _cloud(path: Path) -> object:
    cloud = check_object_cloud(read_cloud(path, drop_invalid=True), path)
    return cloud.in_camera_frame()


def _views(path: Path) -> object:
    read_views_header(path)
    views = read_views(path)
    return describe(path), views.cloud.mean(), views.T_camera_object @ np.eye(4)


def _labels(path: Path) -> object:
    labels = read_labels(path)
    return describe(path), labels.points.mean(axis=1) + labels.sdf


def _grasps(path: Path) -> object:
    grasps, _ = read_grasps(path)
    return describe(path), grasps.count(), grasps.T_world_palm[:, :3, :3], grasps.executed.sum()


def _plan(path: Path) -> object:
    return describe(path), plan_as_json(read_plan(path))


INPUTS = (
    Input("ascii.ply", _cloud),
    Input("binary.ply", _cloud),
    Input("big_endian.ply", _cloud),
    Input("ascii.pcd", _cloud),
    Input("binary.pcd", _cloud),
    Input("compressed.pcd", _cloud),
    Input("cloud.xyz", _cloud),
    Input("cloud.csv", _cloud),
    Input("cloud.npy", _cloud),
    Input("views.h5", _views),
    Input("labels.h5", _labels),
    Input("grasps.h5", _grasps),
    Input("plan.h5", _plan),
    Input("box.obj", load_mesh, 0.4),
    Input("box.stl", load_mesh, 0.4),
    Input("box.ply", load_mesh, 0.4),
    Input("box.off", load_mesh, 0.4),
    Input("box.glb", load_mesh, 0.4),
    Input("box.3mf", load_mesh, 0.2),
    Input("made.ply", read_object_about),
    Input("camera.json", lambda path: load_camera(str(path))),
    Input("pose.json", lambda path: camera_pose(str(path))),
    Input("pose.npy", lambda path: camera_pose(str(path))),
    Input("world/environment.yaml", read_environment),
    Input("robot/gripper.yaml", load_robot),
    Input("robot/gripper.urdf", read_urdf),
    Input("config/config.json", lambda path: load_model(path.parent), 0.3),
    Input("weights/model.safetensors", lambda path: load_model(path.parent), 0.3),
    Input("state/train_state.pt", lambda path: read_train_state(path.parent)),
    Input("archive.tgz", lambda path: extract_mesh(path, path.with_name("extracted"))),
)


def write_inputs(folder: Path) -> None:
    """Write one good file of every kind."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    points = rng.normal(0.0, 0.03, (60, 3)) + [0.0, 0.0, 0.8]
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    _write_clouds(folder, points, normals)
    _write_artifacts(folder, points)
    box = trimesh.creation.box((0.08, 0.06, 0.04))
    for suffix in ("obj", "stl", "ply", "off", "glb", "3mf"):
        box.export(folder / f"box.{suffix}")
    write_object_mesh(folder / "made.ply", box.vertices, box.faces, {"family": "box", "size": 0.1})
    camera = {"width": 64, "height": 48, "K": [[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]]}
    (folder / "camera.json").write_text(json.dumps(camera))
    (folder / "pose.json").write_text(json.dumps(np.eye(4).tolist()))
    np.save(folder / "pose.npy", np.eye(4))
    (folder / "world").mkdir(exist_ok=True)
    box.export(folder / "world" / "box.stl")
    (folder / "world" / "environment.yaml").write_text(
        "table: true\nobstacles:\n  - {name: wall, box: [1.0, 0.02, 1.0], xyz: [0, 0.5, 0.5]}\n"
        "  - {name: ball, sphere: [0.1], xyz: [0.3, 0.2, 0.4], wxyz: [1, 0, 0, 0]}\n"
        "  - {mesh: box.stl, scale: 2.0}\n"
    )
    (folder / "robot").mkdir(exist_ok=True)
    for file in ROBOTS.iterdir():
        (folder / "robot" / file.name).write_bytes(file.read_bytes())
    _write_checkpoints(folder)
    with tarfile.open(folder / "archive.tgz", "w:gz") as tar:
        tar.add(folder / "box.ply", "006/google_16k/nontextured.ply")


def _write_clouds(folder: Path, points: np.ndarray, normals: np.ndarray) -> None:
    cloud = Cloud(points, normals, np.zeros((60, 3), np.uint8), "world", np.eye(4))
    write_cloud(folder / "binary.ply", cloud)
    rows = np.hstack([points, normals]).astype(np.float32)
    head = b"element vertex 60\n" + b"".join(
        b"property float %s\n" % name.encode() for name in ("x", "y", "z", "nx", "ny", "nz")
    )
    text = "\n".join(" ".join(f"{v:.6g}" for v in row) for row in rows).encode()
    comment = b"comment T_world_camera 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n"
    (folder / "ascii.ply").write_bytes(
        b"ply\nformat ascii 1.0\n" + comment + head + b"end_header\n" + text + b"\n"
    )
    (folder / "big_endian.ply").write_bytes(
        b"ply\nformat binary_big_endian 1.0\n"
        + head
        + b"end_header\n"
        + rows.astype(">f4").tobytes()
    )
    fields = (
        b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"
        b"WIDTH 60\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 60\nDATA "
    )
    table = np.zeros(60, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
    for k, axis in enumerate("xyz"):
        table[axis] = points[:, k]
    lines = "\n".join(f"{x:.6g} {y:.6g} {z:.6g} {c}" for x, y, z, c in table).encode()
    (folder / "ascii.pcd").write_bytes(fields + b"ascii\n" + lines)
    (folder / "binary.pcd").write_bytes(fields + b"binary\n" + table.tobytes())
    columns = b"".join(table[name].tobytes() for name in ("x", "y", "z", "rgb"))
    packed = b"".join(
        bytes([len(columns[at : at + 32]) - 1]) + columns[at : at + 32]
        for at in range(0, len(columns), 32)
    )
    sizes = np.array([len(packed), len(columns)], "<u4").tobytes()
    (folder / "compressed.pcd").write_bytes(fields + b"binary_compressed\n" + sizes + packed)
    np.savetxt(folder / "cloud.xyz", rows, fmt="%.6g", header="frame camera")
    np.savetxt(folder / "cloud.csv", rows, fmt="%.6g", delimiter=",", header="x,y,z,a,b,c")
    np.save(folder / "cloud.npy", rows)


def _write_artifacts(folder: Path, points: np.ndarray) -> None:
    poses = np.tile(np.eye(4), (2, 1, 1))
    clouds = np.stack([points, points]).astype(np.float32)
    digest = "0" * 64
    write_views(
        folder / "views.h5", Views(clouds, poses, np.eye(3), (64, 48), 0.001, "m", digest), seed=0
    )
    sdf = np.zeros(60, np.float32)
    write_labels(folder / "labels.h5", Labels(clouds[0], sdf, "m", digest), seed=0)
    one, number = np.ones(2, np.int8), np.ones(2, np.int32)
    grasps = Grasps(
        clouds, poses, poses, poses, np.zeros((2, 3)), one, one, one,
        sdf[:2], sdf[:2], number, number,
    )  # fmt: skip
    meta = GraspsMeta("m", digest, "train", "arm", ("a", "b", "c"), ("c",))
    write_grasps(folder / "grasps.h5", grasps, meta, seed=0)
    plan = Plan(
        "ok", "", "", ("a", "b"), np.zeros(2), np.zeros((3, 2)), np.arange(3.0), np.eye(4), 0.8,
        1.0, 4, {"solve": 0.1}, ("arm", "hand"), np.ones(2), np.ones(2), RejectedSeeds.none(2),
    )  # fmt: skip
    write_plan(folder / "plan.h5", plan, seed=0)


def _write_checkpoints(folder: Path) -> None:
    from pointsdf_cli.models.registry import build_model

    arguments = {
        "centres": (32, 16, 8, 4), "neighbours": (4, 4, 4, 4), "hidden": (4, 4, 4, 4),
        "channels": (4, 4, 4, 4), "width": 8, "blocks": 1, "local": 4,
    }  # fmt: skip
    model = build_model("pointsdf-ray", arguments)
    config = {"architecture": model.architecture, "model": model.config()}
    for name in ("config", "weights"):
        write_checkpoint(folder / name, config=config, weights=model.state_dict())
    state = {"step": 3, "model": {"weight": torch.zeros(3)}, "history": [{"loss": 0.1}]}
    write_checkpoint(folder / "state", config=config, train_state=state)


def tar_of(members: dict[str, bytes]) -> bytes:
    """A `.tgz` of these members."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as tar:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    return buffer.getvalue()
