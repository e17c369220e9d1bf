"""What is damaged: one small good file of each kind, and the reader that a command gives it to."""

from __future__ import annotations

import io
import json
import shutil
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import trimesh
from bags import BEGIN, FRAME, TOPIC, camera_info, image, tf, write_bag
from PIL import Image

from pointsdf_cli.assets import asset_path
from pointsdf_cli.camera.bag_cloud import BagOptions, cloud_of_bag
from pointsdf_cli.camera.intrinsics import read_intrinsics
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.io.board_images import read_grey
from pointsdf_cli.io.checkpoints import read_train_state, write_checkpoint
from pointsdf_cli.io.clouds import Cloud, check_object_cloud, read_cloud, write_cloud
from pointsdf_cli.io.depth_images import read_colour, read_depth, read_mask
from pointsdf_cli.io.meshes import load_mesh
from pointsdf_cli.io.object_mesh import read_object_about, write_object_mesh
from pointsdf_cli.io.poses import camera_pose
from pointsdf_cli.io.robot_poses import read_robot_poses
from pointsdf_cli.models.grasp_checkpoint import read_grasp_checkpoint
from pointsdf_cli.models.registry import load_model
from pointsdf_cli.objects.archive import extract_mesh
from pointsdf_cli.objects.fetch import read_lock
from pointsdf_cli.planning.environment import read_environment
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.robot.urdf import read_urdf
from pointsdf_cli.training.sdf_pack import open_pack, read_pack

from .artifacts import ARTIFACTS, ROBOTS, write_artifacts

PACK = "packs/pack-0123456789abcdef"


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


def _train_state(path: Path) -> object:
    return read_train_state(path.parent)


def _grasp_checkpoint(path: Path) -> object:
    return read_grasp_checkpoint(path.parent)


def _bag(path: Path) -> object:
    return cloud_of_bag(path, BagOptions())[0].points.mean()


def _pack(path: Path) -> object:
    return read_pack(path.parents[1]).names


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
    *(Input(name, read) for name, read in ARTIFACTS.items()),
    Input("box.obj", load_mesh, 0.4),
    Input("box.stl", load_mesh, 0.4),
    Input("box.ply", load_mesh, 0.4),
    Input("box.off", load_mesh, 0.4),
    Input("box.glb", load_mesh, 0.4),
    Input("box.3mf", load_mesh, 0.2),
    Input("made.ply", read_object_about),
    Input("box.dae", load_mesh, 0.2),
    Input("box.gltf", load_mesh, 0.2),
    Input("depth.png", read_depth),
    Input("depth.tiff", read_depth),
    Input("depth.pgm", read_depth),
    Input("depth.npy", read_depth),
    Input("colour.png", read_colour, 0.5),
    Input("colour.jpg", read_colour, 0.5),
    Input("mask.png", lambda path: read_mask(str(path), (48, 64))),
    Input("board.png", read_grey, 0.5),
    Input("robot_poses.json", read_robot_poses),
    Input("robot_poses.csv", read_robot_poses),
    Input("mcap/mcap.mcap", _bag),
    Input("mcap/metadata.yaml", lambda path: _bag(path.parent), 0.5),
    Input("sqlite3/sqlite3.db3", _bag),
    Input("camera.json", lambda path: read_intrinsics(str(path))),
    Input("pose.json", lambda path: camera_pose(str(path))),
    Input("pose.npy", lambda path: camera_pose(str(path))),
    Input("pose.txt", lambda path: camera_pose(str(path))),
    Input("camera_info.yaml", lambda path: read_intrinsics(str(path), 64, 48)),
    Input("open3d.json", lambda path: read_intrinsics(str(path), 64, 48)),
    Input("world/environment.yaml", read_environment),
    Input("robot/gripper.yaml", load_robot),
    Input("robot/gripper.urdf", read_urdf),
    Input("config/config.json", lambda path: load_model(path.parent), 0.3),
    Input("weights/model.safetensors", lambda path: load_model(path.parent), 0.3),
    Input("state/train_state.pt", _train_state),
    Input("success/config.json", _grasp_checkpoint, 0.3),
    Input("success/model.safetensors", _grasp_checkpoint, 0.3),
    Input(f"{PACK}/index.json", _pack),
    Input(f"{PACK}/scale.npy", _pack),
    Input("ycb.lock.json", lambda path: read_lock(path.parent)),
    Input("archive.tgz", lambda path: extract_mesh(path, path.with_name("extracted"))),
)


def write_inputs(folder: Path) -> None:
    """Write one good file of every kind."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(0)
    points = rng.normal(0.0, 0.03, (60, 3)) + [0.0, 0.0, 0.8]
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    _write_clouds(folder, points, normals)
    write_artifacts(folder, points)
    _write_images(folder)
    _write_pack(folder)
    _write_bags(folder)
    box = trimesh.creation.box((0.08, 0.06, 0.04))
    for suffix in ("obj", "stl", "ply", "off", "glb", "3mf", "dae"):
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


def _write_images(folder: Path) -> None:
    depth = (800 + np.arange(48 * 64).reshape(48, 64) % 97).astype(np.uint16)
    for name in ("depth.png", "depth.tiff"):
        Image.fromarray(depth).save(folder / name)
    # Older versions of Pillow cannot write a PGM of 16 bits.
    head = f"P5 {depth.shape[1]} {depth.shape[0]} 65535\n".encode()
    (folder / "depth.pgm").write_bytes(head + depth.astype(">u2").tobytes())
    np.save(folder / "depth.npy", depth)
    colour = np.repeat((depth % 256).astype(np.uint8)[..., None], 3, axis=2)
    for name in ("colour.png", "colour.jpg", "board.png"):
        Image.fromarray(colour).save(folder / name)
    Image.fromarray(np.where(depth > 850, 255, 0).astype(np.uint8)).save(folder / "mask.png")
    poses = {f"image{k}.png": np.eye(4).tolist() for k in range(3)}
    (folder / "robot_poses.json").write_text(json.dumps(poses))
    (folder / "robot_poses.csv").write_text(
        "name,x,y,z,qw,qx,qy,qz\nimage0.png,0.1,0.2,0.3,1,0,0,0\nimage1.png,0.1,0.2,0.4,1,0,0,0\n"
    )
    (folder / "pose.txt").write_text("1 0 0 0.1\n0 1 0 0\n0 0 1 0.5\n0 0 0 1\n")
    (folder / "camera_info.yaml").write_text(
        "image_width: 64\nimage_height: 48\ndistortion_model: plumb_bob\nd: [0, 0, 0, 0, 0]\n"
        "k: [60.0, 0.0, 32.0, 0.0, 60.0, 24.0, 0.0, 0.0, 1.0]\n---\n"
    )
    columns = [60.0, 0, 0, 0, 60.0, 0, 32, 24, 1]
    (folder / "open3d.json").write_text(
        json.dumps({"width": 64, "height": 48, "intrinsic_matrix": columns})
    )
    box = trimesh.creation.box((0.08, 0.06, 0.04))
    model = trimesh.exchange.gltf.export_gltf(trimesh.Scene(box), embed_buffers=True)
    (folder / "box.gltf").write_bytes(model["model.gltf"])
    entry = dict.fromkeys(("url", "sha256", "mesh_sha256", "repair"), "0" * 64) | {"size": 1}
    (folder / "ycb.lock.json").write_text(json.dumps({"format": 1, "objects": {"a": entry}}))


def _write_bags(folder: Path) -> None:
    depth = (800 + np.arange(48 * 64).reshape(48, 64) % 97).astype(np.uint16)
    camera = Camera(64, 48, 60.0, 60.0, 32.0, 24.0)
    messages = [
        (TOPIC, BEGIN, image(BEGIN, depth, "16UC1")),
        ("/camera/depth/camera_info", BEGIN, camera_info(BEGIN, camera)),
        ("/tf_static", BEGIN, tf(BEGIN, {("world", FRAME): np.eye(4)})),
    ]
    for storage in ("mcap", "sqlite3"):
        write_bag(folder / storage, messages, storage)


def _write_pack(folder: Path) -> None:
    """The pack of the views and labels beside it."""
    pack = open_pack([(folder / "views.h5", folder / "labels.h5")], folder / "built")
    assert pack.names
    (folder / PACK).parent.mkdir()
    next((folder / "built").glob("pack-*")).rename(folder / PACK)


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
    shutil.copytree(asset_path("weights/grasp_geometry"), folder / "success", dirs_exist_ok=True)


def tar_of(members: dict[str, bytes]) -> bytes:
    """A `.tgz` of these members."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as tar:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            tar.addfile(info, io.BytesIO(data))
    return buffer.getvalue()
