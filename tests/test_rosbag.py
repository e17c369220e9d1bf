"""`rgrasp cloud` of ROS 2 bags: pixels land where the pinhole camera and the transforms say."""

from __future__ import annotations

import json
import re
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import BEGIN, FRAME, TOPIC, camera_info, compressed, image, png, tf, write_bag
from scipy.spatial.transform import Rotation

from pointsdf_cli.camera.bag_cloud import median_depth
from pointsdf_cli.camera.pinhole import Camera
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import transform
from pointsdf_cli.io.clouds import read_cloud
from tests import scenes

CAMERA = Camera(8, 6, 500.0, 400.0, 3.0, 2.0)
INFO = "/camera/depth/camera_info"
SECOND = 10**9
# base_link → mount: 1 m ahead, 0.5 m up; mount → optical frame: looking down (half a turn about x).
T_BASE_MOUNT = transform(np.eye(3), [1.0, 0.0, 0.5])
T_MOUNT_OPTICAL = transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 0.1])
STATIC = {("base_link", "mount"): T_BASE_MOUNT, ("mount", FRAME): T_MOUNT_OPTICAL}
T_BASE_OPTICAL = transform(np.diag([1.0, -1.0, -1.0]), [1.0, 0.0, 0.6])
# Straight ahead; two pixels to the right at 2 m; three pixels down at 0.8 m.
POINTS = [[0, 0, 1], [0.008, 0, 2], [0, 0.006, 0.8]]


def depth(step: int = 0) -> Any:
    """Millimetres; the first reading grows by `step`."""
    values = np.zeros((6, 8), np.uint16)
    values[2, 3], values[2, 5], values[5, 3] = 1000 + step, 2000, 800
    return values


def messages(images: list[Any], **changes: Any) -> list[tuple[str, int, Any]]:
    """camera_info, static transforms and images, a tenth of a second apart."""
    parts = {
        INFO: (INFO, BEGIN, camera_info(BEGIN, CAMERA)),
        "/tf_static": ("/tf_static", BEGIN, tf(BEGIN, STATIC)),
        **changes,
    }
    found = [part for part in parts.values() if part is not None]
    for index, one in enumerate(images):
        found.append((TOPIC, BEGIN + index * SECOND // 10, one))
    return found


def raw(count: int = 1) -> list[Any]:
    return [image(BEGIN + k * SECOND // 10, depth(10 * k), "16UC1") for k in range(count)]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("single", [False, True], ids=["folder", "file"])
def test_a_bag_becomes_a_cloud_with_its_pose(
    tmp_path: Path, cli: Callable, storage: str, single: bool
) -> None:
    bag = write_bag(tmp_path / "bag", messages(raw()), storage)
    path = next(p for p in bag.iterdir() if p.suffix in (".mcap", ".db3")) if single else bag
    out = tmp_path / "cloud.ply"
    done = cli("cloud", path, "--topic", TOPIC, "--world-frame", "base_link", "--out", out)
    assert done.code == 0, done.err
    cloud = read_cloud(out)
    assert cloud.frame == "camera"
    assert np.allclose(cloud.points, POINTS, atol=1e-6)
    assert np.allclose(cloud.T_world_camera, T_BASE_OPTICAL, atol=1e-9)


def inverse(values: Any) -> bytes:
    """Floats as compressedDepth keeps them: a / depth + b, here with a = 100, b = 1."""
    metres = values / 1000.0
    kept = np.divide(100.0, metres, out=np.full(metres.shape, -1.0), where=metres > 0) + 1
    return png(np.rint(kept).astype(np.uint16), 100.0, 1.0)


FORMS: dict[str, Callable[[], Any]] = {
    "16UC1": lambda: image(BEGIN, depth(), "16UC1"),
    "big-endian": lambda: image(BEGIN, depth().astype(">u2"), "16UC1"),
    "mono16": lambda: image(BEGIN, depth(), "mono16"),
    "32FC1": lambda: image(BEGIN, np.where(depth(), depth() / 1e3, np.nan).astype("<f4"), "32FC1"),
    "compressedDepth": lambda: compressed(BEGIN, "16UC1; compressedDepth png", png(depth())),
    "png": lambda: compressed(BEGIN, "16UC1; png compressed ", png(depth())[12:]),
    "inverse": lambda: compressed(BEGIN, "32FC1; compressedDepth png", inverse(depth())),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_encoding_is_the_same_image(tmp_path: Path, cli: Callable, form: str) -> None:
    bag = write_bag(tmp_path / "bag", messages([FORMS[form]()]))
    done = cli("cloud", bag, "--out", tmp_path / "cloud.ply")
    assert done.code == 0, done.err
    # 100 / 0.8 m and 100 / 2 m are whole numbers, so that nothing is lost.
    assert np.allclose(read_cloud(tmp_path / "cloud.ply").points, POINTS, atol=1e-6)
    assert "base_link" in done.out  # which frames there are, where none is asked for


@pytest.mark.parametrize(
    ("options", "first"),
    [
        ((), 1.0), (("--index", 2), 1.02), (("--index", -1), 1.04), (("--time", 0.25), 1.03),
        (("--frames", 5), 1.02), (("--index", 1, "--frames", 3), 1.02),
    ],
)  # fmt: skip
def test_which_images_are_read(
    tmp_path: Path, cli: Callable, options: tuple[object, ...], first: float
) -> None:
    bag = write_bag(tmp_path / "bag", messages(raw(5)))
    done = cli("cloud", bag, *options, "--out", tmp_path / "cloud.ply", "--json")
    assert done.code == 0, done.err
    assert np.isclose(read_cloud(tmp_path / "cloud.ply").points[0, 2], first, atol=1e-6)
    told = json.loads(done.out)
    assert told["topic"] == TOPIC
    assert told["frame_id"] == FRAME


def test_the_median_removes_noise_and_what_flickers() -> None:
    rng = np.random.default_rng(0)
    depths = (0.8 + rng.normal(0, 0.002, (25, 60, 80))).astype(np.float32)
    depths[:, :30][rng.random((25, 30, 80)) < 0.2] = 0
    depths[:20, 50:] = 0
    median, spread = median_depth(depths)
    assert abs(spread - 0.002) < 1e-4
    # A median's error is 1.25 σ / √n.
    assert abs(np.std(median[30:50] - 0.8) - 1.25 * 0.002 / 5) < 1e-4
    assert (median[:30] > 0).all()  # seen in four of five
    assert (median[50:] == 0).all()  # seen in one of five


def arm(time: int, along: float, angle: float = 0.0) -> tuple[str, int, Any]:
    turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
    return "/tf", time, tf(time, {("base_link", "mount"): transform(turn, [along, 0, 0.5])})


def test_the_median_of_many_images_takes_little_memory() -> None:
    depths = np.random.default_rng(0).uniform(0.5, 1.0, (20, 600, 800)).astype(np.float32)
    tracemalloc.start()
    median_depth(depths)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < depths.nbytes


@pytest.mark.parametrize(("left", "top", "bins"), [(0, 0, 2), (4, 2, 0), (4, 2, 2)])
def test_camera_info_of_binned_and_cropped_images(
    tmp_path: Path, cli: Callable, left: int, top: int, bins: int
) -> None:
    # As ROS defines: K and size of the whole image, the part taken of it, and its binning.
    by = max(bins, 1)
    whole = Camera(
        8 * by + 2 * left, 6 * by + 2 * top, 500.0 * by, 400.0 * by, 3.0 * by + left, 2.0 * by + top
    )
    info = camera_info(BEGIN, whole)
    info.binning_x = info.binning_y = bins
    if left:
        info.roi.x_offset, info.roi.y_offset = left, top
        info.roi.width, info.roi.height = 8 * by, 6 * by
    bag = write_bag(tmp_path / "bag", messages(raw(), **{INFO: (INFO, BEGIN, info)}))
    done = cli("cloud", bag, "--out", tmp_path / "cloud.ply")
    assert done.code == 0, done.err
    assert np.allclose(read_cloud(tmp_path / "cloud.ply").points, POINTS, atol=1e-6)


@pytest.mark.parametrize("packed", [False, True])
def test_depths_in_another_unit_have_a_scale(tmp_path: Path, cli: Callable, packed: bool) -> None:
    one = image(BEGIN, depth().astype("<f4"), "32FC1")
    if packed:  # alone in its bag, it needs no --topic
        one = compressed(BEGIN, "16UC1; compressedDepth png", png(depth()))
    parts = messages([one])
    if packed:
        parts = [(t + "/compressedDepth" if t == TOPIC else t, *rest) for t, *rest in parts]
    bag, out = write_bag(tmp_path / "bag", parts), tmp_path / "cloud.ply"
    done = cli("cloud", bag, "--depth-scale", 0.001, "--out", out)
    assert done.code == 0, done.err
    assert np.allclose(read_cloud(out).points, POINTS, atol=1e-6)
    assert "m a unit" in cli("cloud", bag, "--depth-scale", 0, "--out", out, "--force").err


@pytest.mark.parametrize("command", ["plan", "mesh", "segment"])
def test_commands_that_read_no_bags_name_the_one_that_does(
    tmp_path: Path, cli: Callable, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    bag = write_bag(tmp_path / "bag", messages(raw()))
    for path in (bag, next(bag.glob("*.mcap"))):
        done = cli(command, path)
        assert done.code == 2
        assert "rgrasp cloud reads ROS 2 bags" in done.err


def test_a_camera_on_the_wrist_is_where_the_arm_was_then(tmp_path: Path, cli: Callable) -> None:
    static = ("/tf_static", BEGIN, tf(BEGIN, {("mount", FRAME): T_MOUNT_OPTICAL}))
    moving = [arm(BEGIN + k * SECOND // 20, 1.0, 10.0 * k) for k in range(5)]
    bag = write_bag(tmp_path / "bag", messages(raw(3), **{"/tf_static": static}) + moving)
    base = ("cloud", bag, "--world-frame", "base_link", "--out", tmp_path / "cloud.ply")
    assert cli(*base, "--index", 1).code == 0
    pose = read_cloud(tmp_path / "cloud.ply").T_world_camera
    turn = Rotation.from_euler("z", 20, degrees=True).as_matrix()  # at 0.1 s
    assert pose is not None
    assert np.allclose(pose, transform(turn, [1.0, 0, 0.5]) @ T_MOUNT_OPTICAL, atol=1e-9)
    moved = cli(*base, "--frames", 3, "--force")
    assert moved.code == 2
    assert "the camera moves" in moved.err


def wrist(moving: list[tuple[str, int, Any]], stamps: list[int]) -> list[tuple[str, int, Any]]:
    """A bag's messages: a camera on a moving mount, and an image at each stamp, recorded 0.2 s
    after the beginning and later."""
    static = ("/tf_static", BEGIN, tf(BEGIN, {("mount", FRAME): T_MOUNT_OPTICAL}))
    images = [
        (TOPIC, BEGIN + SECOND // 5 + k, image(stamp, depth(), "16UC1"))
        for k, stamp in enumerate(stamps)
    ]
    return sorted([*messages([], **{"/tf_static": static}), *moving, *images], key=lambda m: m[1])


def test_between_two_transforms_the_camera_is_between(tmp_path: Path, cli: Callable) -> None:
    parts = wrist([arm(BEGIN, 1.0), arm(BEGIN + SECOND // 10, 1.1, 40.0)], [BEGIN + SECOND // 40])
    bag, out = write_bag(tmp_path / "bag", parts), tmp_path / "cloud.ply"
    assert cli("cloud", bag, "--world-frame", "base_link", "--out", out).code == 0
    turn = Rotation.from_euler("z", 10, degrees=True).as_matrix()
    pose = read_cloud(out).T_world_camera
    assert pose is not None
    assert np.allclose(pose, transform(turn, [1.025, 0, 0.5]) @ T_MOUNT_OPTICAL, atol=1e-9)


@pytest.mark.parametrize(
    ("times", "speed", "told"),
    [
        ((0.0, 0.1, 0.2), 0.5, "the camera moves"),  # they end before the image
        ((0.6, 0.7), 0.5, "the camera moves"),
        ((0.0, 0.6), 0.5, "the camera moves"),  # half a second apart
        ((0.0, 0.1, 0.2), 0.0, ""),
        ((0.0, 0.6), 0.0, ""),
        ((2.0, 2.1), 0.0, "base_link → mount is 1.5 s from the image's stamp"),
    ],
)
def test_where_no_transforms_enclose_the_stamp_the_camera_must_stand_still(
    tmp_path: Path, cli: Callable, times: tuple[float, ...], speed: float, told: str
) -> None:
    moving = [arm(BEGIN + round(t * SECOND), 1.0 + speed * t) for t in times]
    bag = write_bag(tmp_path / "bag", wrist(moving, [BEGIN + SECOND // 2]))
    done = cli("cloud", bag, "--world-frame", "base_link", "--out", tmp_path / "cloud.ply")
    assert done.code == (2 if told else 0), done.err
    assert (told or "the pose holds if the camera stood still") in done.err + done.out


def test_a_camera_that_comes_back_has_moved(tmp_path: Path, cli: Callable) -> None:
    stamps = [BEGIN + k * SECOND // 10 for k in range(3)]
    moving = [arm(stamp, x) for stamp, x in zip(stamps, (1.0, 1.1, 1.0), strict=True)]
    bag = write_bag(tmp_path / "bag", wrist(moving, stamps))
    base = ("cloud", bag, "--world-frame", "base_link", "--out", tmp_path / "cloud.ply")
    done = cli(*base, "--frames", 3)
    assert done.code == 2
    assert "the camera moves" in done.err


def test_an_invalid_transform_elsewhere_does_no_harm(tmp_path: Path, cli: Callable) -> None:
    person = tf(BEGIN, {("base_link", "person_1"): np.eye(4)})
    person.transforms[0].transform.rotation.w = 0.0
    bag = write_bag(tmp_path / "bag", [*messages(raw()), ("/tf", BEGIN, person)])
    out = tmp_path / "cloud.ply"
    assert cli("cloud", bag, "--world-frame", "base_link", "--out", out).code == 0
    assert np.allclose(read_cloud(out).T_world_camera, T_BASE_OPTICAL, atol=1e-9)


def test_a_rectified_image_has_the_matrix_of_the_rectified(tmp_path: Path, cli: Callable) -> None:
    # The raw lens: other K and a distortion; P is that of image_rect.
    info = camera_info(BEGIN, CAMERA, (0.1, -0.2, 0, 0, 0))
    info.k[:] = [600, 0, 4, 0, 600, 3, 0, 0, 1]
    changes = {INFO: (INFO, BEGIN, info)}
    bag = write_bag(tmp_path / "bag", messages(raw(), **changes))
    done = cli("cloud", bag, "--out", tmp_path / "cloud.ply")
    assert done.code == 0, done.err
    assert np.allclose(read_cloud(tmp_path / "cloud.ply").points, POINTS, atol=1e-6)


def test_corrected_is_not_rectified(tmp_path: Path, cli: Callable) -> None:
    topic = "/camera/depth_corrected/image_raw"
    info = "/camera/depth_corrected/camera_info"
    renamed = {TOPIC: topic, INFO: info}
    parts = [(renamed.get(t, t), time, m) for t, time, m in messages(raw(), **{INFO: BENT})]
    done = cli("cloud", write_bag(tmp_path / "bag", parts), "--out", tmp_path / "cloud.ply")
    assert done.code == 2
    assert "distorted" in done.err


def test_a_pose_from_the_table_in_a_bag(tmp_path: Path, cli: Callable) -> None:
    seen = scenes.seen(scenes.table(), scenes.box((0.06, 0.08, 0.1), (0.62, 0.12)))
    parts = [
        (INFO, BEGIN, camera_info(BEGIN, scenes.CAMERA)),
        (TOPIC, BEGIN, image(BEGIN, np.round(seen * 1000).astype(np.uint16), "16UC1")),
    ]
    out = tmp_path / "cloud.ply"
    bag = write_bag(tmp_path / "bag", parts)
    done = cli("cloud", bag, "--camera-pose", "table", "--out", out)
    assert done.code == 0, done.err
    pose = read_cloud(out).T_world_camera
    assert pose is not None
    assert pose[2, 3] == pytest.approx(scenes.POSE[2, 3], abs=0.005)


def of(parts: list[tuple[str, int, Any]], *options: object) -> Callable[[Path], list[object]]:
    return lambda folder: [write_bag(folder / "bag", parts), *options]


def with_file(name: str, data: bytes) -> Callable[[Path], list[object]]:
    def write(folder: Path) -> list[object]:
        (folder / name).write_bytes(data)
        return [folder / name]

    return write


def cut_short(folder: Path) -> list[object]:
    bag = write_bag(folder / "bag", messages(raw(3)))
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:300])
    return [bag]


def without_metadata(folder: Path) -> list[object]:
    bag = write_bag(folder / "bag", messages(raw()))
    (bag / "metadata.yaml").unlink()
    return [bag]


def lying_image() -> Any:
    one = image(BEGIN, depth(), "16UC1")
    one.height = 600
    return one


def broken_transform() -> Any:
    """Static transforms, one of them with a quaternion of zeros."""
    message = tf(BEGIN, STATIC)
    turn = message.transforms[0].transform.rotation
    turn.x = turn.y = turn.z = turn.w = 0.0
    return message


RGB = image(BEGIN, np.zeros((6, 8, 3), np.uint8), "rgb8")
OTHER_INFO = (INFO, BEGIN, camera_info(BEGIN, Camera(640, 480, 600, 600, 320, 240)))
BENT = (INFO, BEGIN, camera_info(BEGIN, CAMERA, (0.1, 0, 0, 0, 0)))
RAW = "/camera/depth/image_raw"
UNRECTIFIED = [
    (RAW if t == TOPIC else t, time, m) for t, time, m in messages(raw(), **{INFO: BENT})
]
BENT_AT_0 = (INFO, BEGIN, camera_info(BEGIN, CAMERA))
BENT_AT_0[2].distortion_model = "equidistant"
FISHEYE = [
    (RAW if t == TOPIC else t, time, m) for t, time, m in messages(raw(), **{INFO: BENT_AT_0})
]
JPEG = compressed(BEGIN, "16UC1; jpeg compressed", b"\xff\xd8\xff\xe0" + bytes(50))
RVL = compressed(BEGIN, "16UC1; compressedDepth rvl", bytes(60))
MISTAKES: dict[str, tuple[Callable[[Path], list[object]], str]] = {
    "a topic that is not there": (
        of([*messages(raw()), ("/color/image_raw", BEGIN, RGB)], "--topic", "/depth"),
        f"allowed: {TOPIC}, /color/image_raw",
    ),
    "no images at all": (of(messages([])), "no image topics at all"),
    "two topics of depth images": (
        of([*messages(raw()), (RAW, BEGIN, raw()[0])]), "which images",
    ),
    "a colour topic": (
        of([*messages(raw()), ("/color/image_raw", BEGIN, RGB)], "--topic", "/color/image_raw"),
        "rgb8",
    ),
    "no camera_info": (of(messages(raw(), **{INFO: None})), "--intrinsics K.json"),
    "camera_info of another size": (of(messages(raw(), **{INFO: OTHER_INFO})), "640 × 480"),
    "a fisheye": (of(FISHEYE), "equidistant, which is no pinhole"),
    "a distorted image": (of(UNRECTIFIED), "distorted"),
    "no transforms": (
        of(messages(raw(), **{"/tf_static": None}), "--world-frame", "base_link"), "/tf_static",
    ),
    "a transform that is none": (
        of(messages(raw(), **{"/tf_static": ("/tf_static", BEGIN, broken_transform())}),
           "--world-frame", "base_link"), "base_link → mount is no rotation and translation",
    ),
    "an image before the first": (
        of(messages(raw(3)), "--index", -7), f"has 3 images on {TOPIC}, and image -7",
    ),
    "another frame": (
        of(messages(raw()), "--world-frame", "map"), "frames in the bag: base_link, camera_depth",
    ),
    "two poses": (
        of(messages(raw()), "--world-frame", "base_link", "--camera-pose", "0,0,1,1,0,0,0"),
        "two poses",
    ),
    "JPEG": (of(messages([JPEG])), "jpeg compressed"),
    "RVL": (of(messages([RVL])), "compressedDepth rvl"),
    "a PNG cut short": (
        of(messages([compressed(BEGIN, "16UC1; compressedDepth png", png(depth())[:60])])),
        "not a 16-bit PNG",
    ),
    "an image cut short": (of(messages([lying_image()])), "cut short"),
    "an image beyond the last": (of(messages(raw(3)), "--index", 3), "has 3 images"),
    "more images than there are": (of(messages(raw(3)), "--frames", 4), "has 3 images"),
    "a time beyond the end": (of(messages(raw(3)), "--time", 9), "after 9 s"),
    "no images asked for": (of(messages(raw()), "--frames", 0), "1 to 100"),
    "nothing but gaps": (
        of(messages([image(BEGIN, np.zeros((6, 8), np.uint16), "16UC1")])), "0 everywhere",
    ),
    "a bag of ROS 1": (with_file("a.bag", b"#ROSBAG V2.0\n"), "rosbags-convert"),
    "a file of rubbish": (with_file("a.mcap", b"rubbish" * 100), "not a readable ROS 2 bag"),
    "a database of rubbish": (with_file("a.db3", b"rubbish" * 100), "not a readable ROS 2 bag"),
    "a bag cut short": (cut_short, "not a readable ROS 2 bag"),
    "a folder without metadata": (without_metadata, "ros2 bag reindex"),
    "a colour image beside a bag": (of(messages(raw()), "--color", "a.png"), "leave it out"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_what_cannot_be_used_is_one_message(tmp_path: Path, cli: Callable, name: str) -> None:
    make, message = MISTAKES[name]
    out = tmp_path / "cloud.ply"
    done = cli("cloud", *make(tmp_path), "--out", out)
    assert done.code == 2
    assert re.search(re.escape(message), done.err), done.err
    assert done.err.count("rgrasp: ") == 1
    assert not out.exists()


def test_intrinsics_by_hand_replace_camera_info(tmp_path: Path, cli: Callable) -> None:
    bag = write_bag(tmp_path / "bag", messages(raw(), **{INFO: None}))
    (tmp_path / "K.json").write_text(json.dumps(CAMERA.K.tolist()))
    base = ("cloud", bag, "--intrinsics", tmp_path / "K.json", "--out", tmp_path / "cloud.ply")
    assert cli(*base, "--camera-pose", "0,0,1,0,1,0,0").code == 0
    cloud = read_cloud(tmp_path / "cloud.ply")
    assert np.allclose(cloud.points, POINTS, atol=1e-6)
    looks_down: Array = transform(np.diag([1.0, -1.0, -1.0]), [0, 0, 1])
    assert np.allclose(cloud.T_world_camera, looks_down, atol=1e-9)


def test_options_of_bags_are_refused_for_images(tmp_path: Path, cli: Callable) -> None:
    shutil.copy(Path(__file__), tmp_path / "depth.png")
    assert "is not a bag" in cli("cloud", tmp_path / "depth.png", "--topic", "/depth").err
    assert "--intrinsics" in cli("cloud", tmp_path / "depth.png").err
