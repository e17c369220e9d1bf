"""Self-test of an installation: versions, processor, and reference values for each part."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Callable

import numpy as np

PACKAGES = ("numpy", "torch", "open3d", "trimesh", "manifold3d", "h5py", "libigl", "pybullet")
NETWORKS = (
    *("pointsdf_real", "pointsdf_plan", "pointsdf_ray", "pointsdf", "voxelcnn"),
    *("grasp_geometry", "grasp_scratch", "barrett_geometry", "panda_geometry", "ur5e_geometry"),
)
"""The bundled checkpoints."""


def examine() -> dict[str, tuple[bool, str]]:
    """All checks by their subject, basic parts first; a check that raises has failed.

    Returns:
        Whether each subject is as it must be, and the finding; if it failed, the remedy.
    """
    checks: dict[str, Callable[[], tuple[bool, str]]] = {
        "versions": _versions,
        "processor": _processor,
        "assets": _assets,
        "signed distance of a sphere": _sphere_distance,
        "winding signs of overlapping boxes": _overlap,
        "depth of a sphere": _sphere_depth,
        "artifact round trip": _round_trip,
        "kinematics of the stretched arm": _stretched_arm,
    }
    results = {}
    for name, check in checks.items():
        try:
            results[name] = check()
        except Exception as error:  # whatever is broken, the other checks are still worth having
            results[name] = False, f"{type(error).__name__}: {error}"
    return results


def _versions() -> tuple[bool, str]:
    found, missing = [], []
    for package in PACKAGES:
        try:
            found.append(f"{package} {importlib.metadata.version(package)}")
        except importlib.metadata.PackageNotFoundError:
            missing.append(package)
    # PyBullet is an extra: everything but the simulator works without it.
    fatal = [package for package in missing if package != "pybullet"]
    detail = f"Python {platform.python_version()}, " + ", ".join(found)
    if missing:
        detail += f"; missing: {', '.join(missing)} (pip install -c constraints.txt '.[sim]')"
    return not fatal, detail


def _processor() -> tuple[bool, str]:
    import torch

    from pointsdf_cli.models.processor import bfloat16_is_faster

    cores = len(os.sched_getaffinity(0))
    return True, (
        f"{cores} cores, networks in {'bfloat16' if bfloat16_is_faster() else 'float32'}, "
        f"{torch.cuda.device_count()} CUDA devices"
    )


def _assets() -> tuple[bool, str]:
    from pointsdf_cli.assets import asset_path, assets_folder, bundled_robots
    from pointsdf_cli.io.checkpoints import read_checkpoint

    for name in NETWORKS:
        read_checkpoint(asset_path(f"weights/{name}"))
    robots = ", ".join(bundled_robots()) or "none"
    return True, f"{assets_folder()} (robots: {robots}; {len(NETWORKS)} networks)"


def _sphere_distance() -> tuple[bool, str]:
    import trimesh

    from pointsdf_cli.geometry.signed_distance import SignedDistance

    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (2000, 3))
    found = SignedDistance(ball.vertices, ball.faces, threads=1)(points)
    worst = float(np.abs(found - (np.linalg.norm(points, axis=1) - 0.05)).max())
    return worst < 5e-5, f"worst error {worst * 1e6:.1f} µm of 50 mm"


def _overlap() -> tuple[bool, str]:
    import trimesh

    from pointsdf_cli.geometry.signed_distance import SignedDistance

    shifted = trimesh.creation.box((1, 1, 1)).apply_translation((0.5, 0.01, 0.02))
    both = trimesh.util.concatenate([trimesh.creation.box((1, 1, 1)), shifted])
    inside = SignedDistance(both.vertices, both.faces, 1).inside([[0.25, 0, 0], [0.9, 0, 0]])
    return bool(inside.all()), f"the overlap counts as {'inside' if inside.all() else 'outside'}"


def _sphere_depth() -> tuple[bool, str]:
    import trimesh

    from pointsdf_cli.camera.pinhole import CAMERAS
    from pointsdf_cli.camera.raycast import MeshCaster
    from pointsdf_cli.geometry.frames import transform

    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    caster = MeshCaster(ball.vertices, ball.faces, CAMERAS["reference"])
    nearest = float(caster.cast(transform(np.eye(3), [0, 0, 1.5])).depth.min())
    return abs(nearest - 1.45) < 1e-4, f"nearest depth {nearest:.5f} m, expected 1.45000 m"


def _round_trip() -> tuple[bool, str]:
    from pointsdf_cli.io.hdf5 import read_artifact, write_artifact
    from pointsdf_cli.io.layout import Column
    from pointsdf_cli.io.scratch import Scratch

    array = np.arange(6.0).reshape(2, 3)
    with Scratch() as folder:
        path = folder / "check.h5"
        layout = {"a": Column("f8 [2, 3]", "m")}
        write_artifact(path, schema="check", version=1, layout=layout, arrays={"a": array})
        same = np.array_equal(read_artifact(path, schema="check", version=1).datasets["a"], array)
    return same, "written and read back"


def _stretched_arm() -> tuple[bool, str]:
    import torch

    from pointsdf_cli.robot.description import load_robot
    from pointsdf_cli.robot.kinematics import Kinematics

    robot = load_robot()
    kinematics = Kinematics(robot)
    zero = torch.zeros(1, len(robot.joint_names), dtype=torch.float64)
    _, position = kinematics(zero)
    wrist = float(position[0, kinematics.index("lbr4_link_7"), 2])
    # The sum of the LBR4's joint offsets along z when every joint is at zero.
    expected = 0.11 + 0.2005 + 3 * 0.20 + 0.19 + 0.078
    return abs(wrist - expected) < 1e-9, f"last joint at {wrist:.4f} m, expected {expected:.4f} m"
