"""Real depth images (RealSense, Xtion): what is completed has the size that its maker states.

The captures and their licences are listed in THIRD-PARTY.md. Sizes: the YCB object set's table
(sugar box 38 × 89 × 175 mm, mustard bottle 58 × 95 × 190 mm).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.ndimage import binary_erosion

from pointsdf_cli.assets import asset_path
from pointsdf_cli.camera.cleaning import clean
from pointsdf_cli.camera.depth_cloud import cloud_of_depth
from pointsdf_cli.camera.intrinsics import read_intrinsics
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import apply_transform, is_rigid
from pointsdf_cli.io.clouds import read_cloud
from pointsdf_cli.io.depth_images import read_depth
from pointsdf_cli.io.plans import read_plan
from pointsdf_cli.io.poses import camera_pose

REAL = Path(__file__).parent / "data" / "real"
TOLERANCE = 0.012
"""Sides of a completed object [m]: the sensor's bias, packaging and half of it unseen."""


class Capture(NamedTuple):
    """An object on a table: its folder, its sides and where it stands (x, y), m."""

    folder: Path
    sides: tuple[float, float, float]
    place: tuple[float, float]


# The places come from a registration of the scanned objects to these images.
CAPTURES = {
    "sugar": Capture(REAL / "sugar", (0.038, 0.089, 0.175), (0.576, 0.002)),
    "mustard": Capture(asset_path("captures/mustard"), (0.058, 0.095, 0.190), (0.578, 0.005)),
}


@pytest.fixture(scope="module", params=CAPTURES)
def capture(request: pytest.FixtureRequest) -> Capture:
    return CAPTURES[request.param]


def scene_cloud(capture: Capture, out: Path, cli: Callable) -> Path:
    done = cli(
        "cloud", capture.folder / "depth.png", "--depth-scale", 0.0001, "--intrinsics",
        capture.folder / "K.json", "--camera-pose", capture.folder / "T_world_camera.json",
        "--out", out,
    )  # fmt: skip
    assert done.code == 0, done.err
    return out


def world(capture: Capture, points: Array) -> Array:
    return apply_transform(camera_pose(str(capture.folder / "T_world_camera.json")), points)


def test_the_table_is_at_zero(capture: Capture, tmp_path: Path, cli: Callable) -> None:
    points = read_cloud(scene_cloud(capture, tmp_path / "c.ply", cli)).points
    height = world(capture, points)[:, 2]
    # Most of the image is the table, good to 3 mm where the camera sees it well.
    assert np.mean(np.abs(height) < 0.003) > 0.5


def test_the_completed_object_is_as_large_as_the_real_one(
    capture: Capture, tmp_path: Path, cli: Callable
) -> None:
    cloud = scene_cloud(capture, tmp_path / "c.ply", cli)
    done = cli("mesh", cloud, "--segment", "auto", "--out", tmp_path / "m.ply", "--resolution", 64)
    assert done.code == 0, done.err
    mesh = trimesh.load(tmp_path / "m.ply")
    assert mesh.is_watertight
    assert mesh.body_count == 1
    sides = np.sort(mesh.bounding_box_oriented.primitive.extents)
    assert np.allclose(sides, capture.sides, atol=TOLERANCE)
    low, high = (f(world(capture, mesh.vertices), axis=0) for f in (np.min, np.max))
    assert abs(low[2]) < 0.008  # it stands on the table
    assert abs(high[2] - capture.sides[2]) < 0.010
    assert np.allclose((low + high)[:2] / 2, capture.place, atol=0.010)


def test_a_grasp_is_planned_on_a_real_depth_image(tmp_path: Path, cli: Callable) -> None:
    folder = CAPTURES["mustard"].folder
    done = cli(
        "plan", folder / "depth.png", "--depth-scale", 0.0001, "--intrinsics", folder / "K.json",
        "--camera-pose", folder / "T_world_camera.json", "--out", tmp_path / "plan.h5",
        "--no-picture", "-q",
    )  # fmt: skip
    assert done.code == 0, done.err
    plan = read_plan(tmp_path / "plan.h5")
    assert plan.status == "ok"
    assert is_rigid(plan.T_world_palm)
    # The palm is beside the bottle: nearer to its axis than a finger is long, and not under it.
    away = np.linalg.norm(plan.T_world_palm[:2, 3] - CAPTURES["mustard"].place)
    assert away < 0.25
    assert 0.02 < plan.T_world_palm[2, 3] < 0.35


def test_cleaning_keeps_the_bottle_of_a_cluttered_image() -> None:
    folder = REAL / "ycbv"
    depth = read_depth(folder / "depth.png", 0.0001)[0]
    height, width = depth.shape
    mask = binary_erosion(np.asarray(Image.open(folder / "label.png")) == 5)  # the mustard bottle
    camera = read_intrinsics(str(folder / "K.json"), width, height)
    points = cloud_of_depth(np.where(mask, depth, 0.0), camera).points
    kept = points[clean(points).kept]
    diagonal = float(np.linalg.norm(CAPTURES["mustard"].sides))
    # Behind the bottle's edges the sensor saw things that are not there.
    assert np.ptp(points[:, 2]) > 0.3
    assert np.ptp(kept, axis=0).max() < diagonal
    assert len(kept) > 0.9 * len(points)


def test_a_crop_keeps_its_camera() -> None:
    # The cut begins at column 130 and row 40 of the published camera's image.
    K = np.array(json.loads((REAL / "ycbv" / "K.json").read_text()))
    published = [[1066.778, 0, 312.9869], [0, 1067.487, 241.3109], [0, 0, 1]]
    assert np.allclose(K + [[0, 0, 130], [0, 0, 40], [0, 0, 0]], published)


def test_an_empty_depth_image_is_one_message(tmp_path: Path, cli: Callable) -> None:
    Image.fromarray(np.zeros((480, 640), np.uint16)).save(tmp_path / "depth.png")
    folder = CAPTURES["sugar"].folder
    out = tmp_path / "c.ply"
    done = cli("cloud", tmp_path / "depth.png", "--intrinsics", folder / "K.json", "--out", out)
    assert done.code == 2
    assert "0 everywhere" in done.err
    assert not out.exists()
