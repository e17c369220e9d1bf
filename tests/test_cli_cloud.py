"""Depth images become clouds: pixels land where a hand calculation says, forms of K agree."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image

from pointsdf_cli.camera.intrinsics import read_intrinsics
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.camera.raycast import MeshCaster, depth_image
from pointsdf_cli.camera.scene_file import SceneFileOptions, read_view
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.clouds import read_cloud
from pointsdf_cli.io.depth_images import read_depth

WIDTH, HEIGHT = 8, 6
FX, FY, CX, CY = 500.0, 400.0, 3.0, 2.0
K = [[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]]
FLAT = [FX, 0, CX, 0, FY, CY, 0, 0, 1]
SIZE = {"width": WIDTH, "height": HEIGHT}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A depth image of 8 × 6 pixels with three readings [mm], and its K."""
    depth = np.zeros((HEIGHT, WIDTH), np.uint16)
    depth[2, 3], depth[2, 5], depth[5, 3] = 1000, 2000, 800
    Image.fromarray(depth).save(tmp_path / "depth.png")
    (tmp_path / "K.json").write_text(json.dumps(K))
    return tmp_path


def test_pixels_land_where_the_pinhole_says(folder: Path, cli: Callable) -> None:
    out = folder / "cloud.ply"
    base = ("cloud", folder / "depth.png", "--intrinsics", folder / "K.json", "--out", out)
    done = cli(*base)  # so sparse an image says nothing of flying pixels
    assert done.code == 0, done.err
    points = read_cloud(out).points
    # The principal point looks straight ahead; two pixels to the right at 2 m are 2/500·2 m;
    # three pixels down at 0.8 m are 3/400·0.8 m.
    assert np.allclose(points, [[0, 0, 1], [0.008, 0, 2], [0, 0.006, 0.8]], atol=1e-6)
    assert "45 pixels" in done.out


def test_pose_and_colours_travel_with_the_cloud(folder: Path, cli: Callable) -> None:
    pose = transform([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], [0.6, 0.0, 1.0])
    (folder / "T.json").write_text(json.dumps(pose.tolist()))
    colour = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    colour[2, 3], colour[2, 5], colour[5, 3] = (255, 0, 0), (0, 255, 0), (1, 2, 3)
    Image.fromarray(colour).save(folder / "rgb.png")
    done = cli(
        "cloud", folder / "depth.png", "--intrinsics", folder / "K.json", "--camera-pose",
        folder / "T.json", "--color", folder / "rgb.png", "--out", folder / "c.ply", "--json",
        "--no-clean",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert json.loads(done.out)["has_pose"]
    cloud = read_cloud(folder / "c.ply")
    assert cloud.frame == "camera"
    assert np.allclose(cloud.T_world_camera, pose)
    assert np.array_equal(cloud.colours, [[255, 0, 0], [0, 255, 0], [1, 2, 3]])


FORMS: dict[str, Any] = {
    "matrix.json": K,
    "camera.json": {"K": K, **SIZE},
    "ros1.yaml": {"K": FLAT, "D": [0.0] * 5, "distortion_model": "plumb_bob", **SIZE},
    "ros2.yaml": {"k": FLAT, "d": [0, 0, 0, 0, 0], **SIZE},
    "calibration.yaml": {
        "image_width": WIDTH,
        "camera_matrix": {"rows": 3, "cols": 3, "data": FLAT},
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0, 0, 0, 0, 0]},
    },
    "realsense.json": {"fx": FX, "fy": FY, "ppx": CX, "ppy": CY, "coeffs": [0] * 5,
                       "model": "distortion.brown_conrady", **SIZE},
    "stereo.json": {"K": K, "K1": K, "P1": [*FLAT, 0, 0, 0], "distance": 0.5, **SIZE,
                    "model": "OmniVision", "distortion": {"type": "none", "rows": 1, "k1": 0.0}},
    "nested.json": {"depth": {"fx": FX, "fy": FY, "ppx": CX, "ppy": CY, **SIZE}, "serial": "1"},
    "open3d.json": {"intrinsic_matrix": [FX, 0, 0, 0, FY, 0, CX, CY, 1], **SIZE},
}  # fmt: skip


@pytest.mark.parametrize("name", FORMS)
def test_every_form_of_intrinsics_is_the_same_camera(tmp_path: Path, name: str) -> None:
    write = json.dumps if name.endswith("json") else yaml.safe_dump
    (tmp_path / name).write_text(write(FORMS[name]))
    camera = read_intrinsics(str(tmp_path / name), WIDTH, HEIGHT)
    assert camera == Camera(WIDTH, HEIGHT, FX, FY, CX, CY)
    if name.endswith("yaml"):  # as `ros2 topic echo` ends a message
        (tmp_path / name).write_text(f"{yaml.safe_dump(FORMS[name])}---\n")
        assert read_intrinsics(str(tmp_path / name), WIDTH, HEIGHT) == camera


@pytest.mark.parametrize("bent", [False, True])
def test_a_file_of_opencv_is_read(tmp_path: Path, bent: bool) -> None:
    path = tmp_path / "K.yaml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", WIDTH)
    storage.write("camera_matrix", np.array(K, dtype=float))
    storage.write("distortion_coefficients", np.array([[0.2 * bent, 0, 0, 0, 0]]))
    storage.release()
    head = "%YAML:1.0" if bent else "%YAML 1.2"  # OpenCV 4's and 5's
    path.write_text("\n".join([head, *path.read_text().splitlines()[1:]]))
    if bent:
        with pytest.raises(InputError, match="camera distortion"):
            read_intrinsics(str(path), WIDTH, HEIGHT)
    else:
        assert read_intrinsics(str(path), WIDTH, HEIGHT) == Camera(WIDTH, HEIGHT, FX, FY, CX, CY)


WRONG: dict[str, tuple[Any, str]] = {
    "bent.json": ({"K": K, "D": [0.1, -0.2, 0, 0, 0], **SIZE}, "camera distortion"),
    "size.json": ({"K": K, "width": 640, "height": 480}, "640 × 480"),
    "calibration.json": (
        {"camera_matrix": K, "image_width": 640, "image_height": 480},
        "640 × 480",
    ),
    "wide.json": ({"K": K, "width": 640}, f"640 × {HEIGHT}"),
    "skew.json": ([[FX, 3, CX], [0, FY, CY], [0, 0, 1]], "skew"),
    "outside.json": ([[FX, 0, 320], [0, FY, 240], [0, 0, 1]], "outside the image"),
    "empty.json": ({}, "no intrinsics"),
    "text.json": ("hello", "no 3×3 matrix"),
    "flat.json": ({"fx": "wide", "fy": 1, "cx": 1, "cy": 1}, "not numbers"),
    "negative.json": ([[-FX, 0, CX], [0, FY, CY], [0, 0, 1]], "focal"),
    "nan.json": ([[float("nan"), 0, CX], [0, FY, CY], [0, 0, 1]], "holds NaN"),
    "half.json": ({"K": K, "width": 8.5, "height": 6}, "8.5"),
    "named.json": ({"fx": FX, "fy": FY, "cx": CX, "cy": CY, "k1": 0.5}, "camera distortion"),
    "kalibr.json": ({"K": K, "distortion_coeffs": [0.3, 0, 0, 0]}, "camera distortion"),
    "outer.json": ({"distortion": [0.3], "intrinsics": {"K": K}}, "camera distortion"),
    "around.json": ({"width": 640, "height": 480, "depth": {"K": K}}, "640 × 480"),
    "mapping.json": ({"K": K, "distortion": {"model": "x", "k1": 0.3}}, "camera distortion"),
    **{
        f"{name}.json": ({"K": K, name: value}, "camera distortion")
        for name, value in {
            "dist": [[0.12, -0.25, 0, 0, 0]], "distCoeffs": [0.1], "dist_coefs": [[0, 0.2]],
            "distortion_parameters": [0.1], "K1": 0.2, "k2": "0.1",
            "distortion": {"model": "plumb_bob", "coefficients": [0.2, -0.3, 0, 0, 0]},
        }.items()
    },
    "fisheye.json": ({"K": K, "d": [0] * 4, "distortion_model": "equidistant"}, "no pinhole"),
    "odd.json": ({"K": K, "distortion": {"model": "field_of_view", "w": 0}}, "no pinhole"),
    "colmap.json": ({"K": K, "camera_model": "OPENCV_FISHEYE", "k1": 0.0}, "no pinhole"),
    "infinite.json": ({"fx": FX, "fy": FY, "cx": float("inf"), "cy": CY}, "not finite"),
    "endless.json": ({"fx": 10**400, "fy": 1, "cx": 1, "cy": 1}, "not numbers"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_intrinsics_that_cannot_be_used_say_why(folder: Path, cli: Callable, name: str) -> None:
    data, message = WRONG[name]
    (folder / name).write_text(json.dumps(data))
    out = folder / "o.ply"
    done = cli("cloud", folder / "depth.png", "--intrinsics", folder / name, "--out", out)
    assert done.code == 2
    assert message in done.err
    assert not out.exists()


def test_floats_are_metres_and_gaps_are_dropped(tmp_path: Path) -> None:
    depth = np.array([[1.5, np.nan], [0.0, -1.0]], np.float32)
    np.save(tmp_path / "d.npy", depth)
    assert np.array_equal(read_depth(tmp_path / "d.npy")[0], [[1.5, 0], [0, 0]])
    assert np.allclose(read_depth(tmp_path / "d.npy", 0.1)[0], [[0.15, 0], [0, 0]])
    Image.fromarray(np.array([[4000, 0]], np.uint16)).save(tmp_path / "d.png")
    assert np.allclose(read_depth(tmp_path / "d.png", 0.00025)[0], [[1.0, 0]])


@pytest.mark.parametrize(
    ("head", "greatest"), [(b"P5", 65535), (b"P5", 10000), (b"P5", 1023), (b"P2", 4095)]
)
def test_a_pgm_says_what_was_written_in_it(tmp_path: Path, head: bytes, greatest: int) -> None:
    depths = np.arange(900, 1000).reshape(10, 10)
    text = b" ".join(b"%d" % value for value in depths.ravel())
    body = text if head == b"P2" else depths.astype(">u2").tobytes()
    (tmp_path / "d.pgm").write_bytes(head + b"\n# 9 9 9\n10 10\n%d\n" % greatest + body)
    np.testing.assert_array_equal(read_depth(tmp_path / "d.pgm")[0], depths * 0.001)


def test_a_pgm_of_comments_alone_is_refused(tmp_path: Path) -> None:
    image = b"P5\n" + b"# " + b"x" * 5000 + b"\n2 2\n65535\n" + b"\x03\xe8" * 4
    (tmp_path / "long.pgm").write_bytes(image)
    np.testing.assert_array_equal(read_depth(tmp_path / "long.pgm")[0], np.ones((2, 2)))


def test_typed_intrinsics_are_one_message(folder: Path, cli: Callable) -> None:
    typed = "[[" + "0, " * 200 + "1]]"
    for wrong in (typed, str(folder)):
        done = cli("cloud", folder / "depth.png", "--intrinsics", wrong, "--out", folder / "o.ply")
        assert done.code == 2
        assert "no such intrinsics" in done.err


def test_negative_depths_and_huge_images_are_one_message(tmp_path: Path) -> None:
    np.save(tmp_path / "d.npy", [[0.0, -1.0]])
    with pytest.raises(InputError, match="negative") as told:
        read_depth(tmp_path / "d.npy")
    assert "OpenGL" in str(told.value.hint)
    Image.new("1", (10_000, 10_000)).save(tmp_path / "d.png")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match="10000 × 10000"):
            read_depth(tmp_path / "d.png")


def test_an_unknown_suffix_beside_intrinsics_names_depth_images(tmp_path: Path) -> None:
    (tmp_path / "d.exr").write_bytes(b"v/1")
    with pytest.raises(InputError, match="depth images") as told:
        read_view(tmp_path / "d.exr", SceneFileOptions("kinect2"))
    assert ".png" in str(told.value.allowed)


def test_what_is_no_depth_image_is_refused(tmp_path: Path) -> None:
    Image.new("RGB", (4, 4)).save(tmp_path / "rgb.png")
    Image.new("L", (4, 4)).save(tmp_path / "grey.png")
    np.save(tmp_path / "cloud.npy", np.zeros((4, 4, 3)))
    np.save(tmp_path / "text.npy", np.array([["a"]]))
    np.save(tmp_path / "object.npy", np.array([[None]]), allow_pickle=True)
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"0" * 50)
    (tmp_path / "depth.exr").write_bytes(b"v/1\x01")
    names = ["rgb.png", "grey.png", "cloud.npy", "text.npy", "object.npy", "broken.png"]
    for name in [*names, "depth.exr", "absent.png", "absent.npy"]:
        with pytest.raises(InputError):
            read_depth(tmp_path / name)


def test_a_wrong_scale_or_colour_image_is_told(folder: Path, cli: Callable) -> None:
    base = ("cloud", folder / "depth.png", "--intrinsics", folder / "K.json", "--out")
    far = cli(*base, folder / "o.ply", "--depth-scale", 1)
    assert far.code == 2
    assert "--depth-scale 0.001 (" in far.err
    Image.new("RGB", (4, 4)).save(folder / "rgb.png")
    other = cli(*base, folder / "o.ply", "--color", folder / "rgb.png")
    assert other.code == 2
    assert "registered" in other.err
    assert cli(*base, folder / "o.ply", "--camera-pose", "1,2").code == 2
    assert cli(*base, folder / "o.pcd").code == 2


def test_a_rendered_box_comes_back_where_it_stands(
    tmp_path: Path, box_mesh: Any, cli: Callable
) -> None:
    camera = Camera(160, 120, 150.0, 150.0, 80.0, 60.0)
    stands = transform(np.eye(3), [0.02, -0.01, 0.5])
    patch = MeshCaster(box_mesh.vertices, box_mesh.faces, camera).cast(stands)
    millimetres = np.round(depth_image(patch, camera) * 1000).astype(np.uint16)
    Image.fromarray(millimetres).save(tmp_path / "depth.png")
    (tmp_path / "K.json").write_text(json.dumps(camera.K.tolist()))
    out = tmp_path / "cloud.ply"
    done = cli("cloud", tmp_path / "depth.png", "--intrinsics", tmp_path / "K.json", "--out", out)
    assert done.code == 0, done.err
    points = read_cloud(out).points
    # The face that is seen is 4 cm / 2 nearer than the middle.
    assert np.allclose(points[:, 2], 0.48, atol=5e-4)
    pixel = 0.48 / 150
    assert np.allclose(points[:, 0].min(), 0.02 - 0.04, atol=pixel)
    assert np.allclose(points[:, 1].max(), -0.01 + 0.03, atol=pixel)
