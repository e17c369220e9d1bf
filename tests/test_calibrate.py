"""`rgrasp calibrate` finds the pose that images of a board were rendered with."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from board_images import (
    HD,
    T_GRIPPER_BOARD,
    T_GRIPPER_CAMERA,
    T_WORLD_CAMERA,
    boards_in_view,
    render_board,
    robot_poses,
)
from PIL import Image
from scipy.spatial.transform import Rotation

from pointsdf_cli.camera.charuco import BoardView, CharucoBoard, find_board, without_distortion
from pointsdf_cli.camera.hand_eye import calibrate_hand_eye
from pointsdf_cli.camera.intrinsics import read_lens
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.geometry.frames import (
    apply_transform,
    invert_transform,
    random_rotation,
    rotation_vector,
    transform,
)
from pointsdf_cli.geometry.hand_eye import rotation_spread, solve_hand_eye
from pointsdf_cli.io.poses import camera_pose
from pointsdf_cli.io.robot_poses import read_robot_poses

ROBOTS = Path(__file__).parent / "robots"
BOARD = CharucoBoard()
COUNT = 15
TURN = Rotation.from_euler("xyz", [10, 20, -30], degrees=True)
POSE = transform(TURN.as_matrix(), [0.4, -0.1, 0.6])


def apart(a: Array, b: Array) -> tuple[float, float]:
    """Distance [mm] and angle [degrees] between two poses."""
    change = invert_transform(a) @ b
    angle = np.linalg.norm(rotation_vector(change[:3, :3]))
    return 1000 * float(np.linalg.norm(change[:3, 3])), float(np.degrees(angle))


@pytest.fixture(scope="module")
def seen() -> list[Array]:
    """T_camera_board of 15 images."""
    return boards_in_view(BOARD, HD, COUNT, np.random.default_rng(5))


@pytest.fixture(scope="module")
def rendered(seen: list[Array], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `images/`, `K.json`, `fixed.json` (eye-to-hand) and `wrist.json`."""
    folder = tmp_path_factory.mktemp("calibration")
    (folder / "images").mkdir()
    rng = np.random.default_rng(6)
    for index, T in enumerate(seen):
        Image.fromarray(render_board(BOARD, HD, T, rng)).save(folder / f"images/{index}.png")
    for name, eye_in_hand in (("fixed", False), ("wrist", True)):
        poses = [pose.tolist() for pose in robot_poses(seen, eye_in_hand)]
        (folder / f"{name}.json").write_text(json.dumps(poses))
    (folder / "K.json").write_text(json.dumps(HD.K.tolist()))
    return folder


def views_of(seen: list[Array]) -> list[BoardView]:
    """Corners without a renderer: projected, with 0.05 px of noise."""
    rng = np.random.default_rng(2)
    ids = np.arange(len(BOARD.corners))
    found = [HD.project(apply_transform(T, BOARD.corners)) for T in seen]
    return [BoardView(ids, pixels + rng.normal(0, 0.05, pixels.shape)) for pixels in found]


def test_a_fixed_camera_is_found(rendered: Path, tmp_path: Path, cli: Callable) -> None:
    out = tmp_path / "T.json"
    done = cli(
        "calibrate", rendered / "images", "--intrinsics", rendered / "K.json", "--robot-poses",
        rendered / "fixed.json", "--out", out, "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    millimetres, degrees = apart(camera_pose(str(out)), T_WORLD_CAMERA)
    assert millimetres < 0.3
    assert degrees < 0.06  # 0.002 with OpenCV 5, whose corners are finer than those of 4.10
    told = json.loads(done.out)
    assert told["images_used"] == COUNT
    assert told["error_px"] < 0.2
    assert told["warnings"] == []
    assert told["error_mm"] < 0.5
    assert apart(np.array(told["T_target_board"]), T_GRIPPER_BOARD)[0] < 0.5


@pytest.mark.parametrize(("square", "focal"), [(0.033, 1.0), (0.040, 1.0), (0.035, 1.05)])
def test_large_residuals_are_a_warning(
    rendered: Path, tmp_path: Path, cli: Callable, square: float, focal: float
) -> None:
    K = np.diag([focal, focal, 1.0]) @ HD.K
    K[:2, 2] = HD.K[:2, 2]
    (tmp_path / "K.json").write_text(json.dumps(K.tolist()))
    done = cli(
        "calibrate", rendered / "images", "--intrinsics", tmp_path / "K.json", "--robot-poses",
        rendered / "fixed.json", "--square", square, "--out", tmp_path / "T.json", "--json", "-q",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert "check --square" in done.err
    assert json.loads(done.out)["warnings"][0] in done.err


def test_a_camera_on_the_wrist_is_found(rendered: Path, tmp_path: Path, cli: Callable) -> None:
    base = (
        "calibrate", rendered / "images", "--intrinsics", rendered / "K.json", "--robot-poses",
        rendered / "wrist.json", "--eye-in-hand",
    )  # fmt: skip
    done = cli(*base, "--out", tmp_path / "X.json")
    assert done.code == 0, done.err
    assert "T_world_gripper · T_gripper_camera" in done.out
    found = camera_pose(str(tmp_path / "X.json"))
    millimetres, degrees = apart(found, T_GRIPPER_CAMERA)
    assert millimetres < 0.3
    assert degrees < 0.06  # 0.002 with OpenCV 5, whose corners are finer than those of 4.10
    np.save(tmp_path / "at.npy", POSE)
    done = cli(*base, "--at", tmp_path / "at.npy", "--out", tmp_path / "T.json", "-q")
    assert done.code == 0, done.err
    assert apart(camera_pose(str(tmp_path / "T.json")), POSE @ found)[0] < 1e-6


def test_the_unit_of_poses_holds_for_at(rendered: Path, tmp_path: Path, cli: Callable) -> None:
    scale = np.diag([1e3, 1e3, 1e3, 1.0])
    given = json.loads((rendered / "wrist.json").read_text())
    millimetres = [scale @ pose @ np.linalg.inv(scale) for pose in given]
    (tmp_path / "wrist.json").write_text(json.dumps([pose.tolist() for pose in millimetres]))
    np.save(tmp_path / "at.npy", scale @ POSE @ np.linalg.inv(scale))
    np.save(tmp_path / "metres.npy", POSE)
    found = []
    for poses, at, unit in (
        (rendered / "wrist.json", "metres.npy", "m"),
        (tmp_path / "wrist.json", "at.npy", "mm"),
    ):
        done = cli(
            "calibrate", rendered / "images", "--intrinsics", rendered / "K.json",
            "--robot-poses", poses, "--eye-in-hand", "--at", tmp_path / at,
            "--pose-unit", unit, "--out", tmp_path / f"{unit}.json",
        )  # fmt: skip
        assert done.code == 0, done.err
        found.append(camera_pose(str(tmp_path / f"{unit}.json")))
    np.testing.assert_allclose(*found, atol=1e-6)


def test_the_robots_mount_leads_from_its_root_to_the_world(
    rendered: Path, tmp_path: Path, cli: Callable
) -> None:
    done = cli(
        "calibrate", rendered / "images", "--intrinsics", rendered / "K.json", "--robot-poses",
        rendered / "fixed.json", "--robot", ROBOTS / "gripper.yaml", "--out", tmp_path / "T.json",
    )  # fmt: skip
    assert done.code == 0, done.err
    # The gripper's YAML: 0.1, -0.2, 0 and a quarter turn about z.
    mount = transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.1, -0.2, 0])
    assert apart(camera_pose(str(tmp_path / "T.json")), mount @ T_WORLD_CAMERA)[0] < 0.3


def test_a_wrong_pose_and_an_image_without_a_board_are_named(
    rendered: Path, tmp_path: Path, cli: Callable
) -> None:
    shutil.copytree(rendered / "images", tmp_path / "images")
    Image.new("L", (HD.width, HD.height), 90).save(tmp_path / "images" / "4.png")
    poses = json.loads((rendered / "fixed.json").read_text())
    poses[9][0][3] += 0.02
    named = {f"{index}.png": pose for index, pose in enumerate(poses)}
    (tmp_path / "poses.json").write_text(json.dumps(named))
    done = cli(
        "calibrate", tmp_path / "images", "--intrinsics", rendered / "K.json", "--robot-poses",
        tmp_path / "poses.json", "--out", tmp_path / "T.json", "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert told["outliers"] == ["9.png"]
    assert told["without_board"] == ["4.png"]
    wrong = next(image for image in told["images"] if image["image"] == "9.png")
    assert 15 < wrong["error_mm"] < 25  # the pose is off by 20 mm
    assert apart(camera_pose(str(tmp_path / "T.json")), T_WORLD_CAMERA)[0] < 0.5


@pytest.mark.parametrize("eye_in_hand", [False, True])
def test_the_standard_deviation_tells_the_error(seen: list[Array], eye_in_hand: bool) -> None:
    # A robot that is off by 0.3 mm and 0.03° at each pose.
    truth = T_GRIPPER_CAMERA if eye_in_hand else T_WORLD_CAMERA
    ratios = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        turns = Rotation.from_rotvec(rng.normal(0, np.radians(0.03), (COUNT, 3))).as_matrix()
        robot = np.stack(robot_poses(seen, eye_in_hand))
        robot = robot @ transform(turns, rng.normal(0, 3e-4, (COUNT, 3)))
        found = calibrate_hand_eye(robot, views_of(seen), BOARD.corners, HD, eye_in_hand)
        ratios.append(apart(found.X, truth)[0] / found.sigma_mm)
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 2


def test_the_closed_form_is_exact_without_noise() -> None:
    rng = np.random.default_rng(3)
    X, Z = (transform(random_rotation(rng), rng.normal(size=3)) for _ in range(2))
    moving = transform(random_rotation(rng, 4), rng.normal(size=(4, 3)))
    board = invert_transform(moving @ X) @ Z
    found = solve_hand_eye(moving, board)
    assert np.allclose(found.X, X, atol=1e-9)
    assert np.allclose(found.Z, Z, atol=1e-9)


def test_the_spread_of_rotations_counts_axes() -> None:
    about_z = transform(
        Rotation.from_euler("z", [[0], [20], [40]], degrees=True).as_matrix(), np.zeros((3, 3))
    )
    spread = np.degrees(rotation_spread(about_z))
    # Pairs differ by 20, 20 and 40 degrees.
    assert np.allclose(spread, [np.sqrt((400 + 400 + 1600) / 3), 0, 0], atol=1e-4)


@pytest.mark.parametrize("coefficients", [[0.12, -0.2, 1e-3, -5e-4], [0.1, -0.2, 0, 0, 0.05]])
def test_distortion_is_taken_out(tmp_path: Path, coefficients: list[float]) -> None:
    K = {"k": HD.K.ravel().tolist(), "d": coefficients, "width": HD.width, "height": HD.height}
    (tmp_path / "info.json").write_text(json.dumps({**K, "distortion_model": "plumb_bob"}))
    camera, lens = read_lens(str(tmp_path / "info.json"), HD.width, HD.height)
    assert camera == HD
    rays = np.random.default_rng(0).uniform([-0.6, -0.35, 1], [0.6, 0.35, 1], (50, 3))
    bent = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), HD.K, np.array(coefficients))[0]
    view = BoardView(np.arange(50), bent.reshape(-1, 2))
    straight = without_distortion(view, camera, lens).pixels
    assert np.abs(bent.reshape(-1, 2) - HD.project(rays)).max() > 2
    assert np.allclose(straight, HD.project(rays), atol=1e-4)


def test_another_model_of_distortion_is_refused(tmp_path: Path) -> None:
    fish = {"K": HD.K.tolist(), "D": [0.1, 0, 0, 0], "distortion_model": "equidistant"}
    (tmp_path / "K.json").write_text(json.dumps(fish))
    with pytest.raises(InputError, match="equidistant"):
        read_lens(str(tmp_path / "K.json"), HD.width, HD.height)


def test_distortion_has_many_names(tmp_path: Path) -> None:
    numbers, path = [0.12, -0.2, 1e-3, -5e-4], tmp_path / "K.json"
    named = dict(zip(("k1", "k2", "p1", "p2"), numbers, strict=True))
    inside = {"model": "plumb_bob", "coefficients": numbers}
    for lens in ({"dist": [numbers]}, {"distortion": inside}, {"distortion": named}, named):
        path.write_text(json.dumps({"K": HD.K.tolist(), **lens}))
        assert read_lens(str(path), HD.width, HD.height)[1][:4] == tuple(numbers)


@pytest.mark.parametrize("suffix", ["png", "pdf"])
def test_the_board_is_printed_to_scale(tmp_path: Path, cli: Callable, suffix: str) -> None:
    page = tmp_path / f"board.{suffix}"
    done = cli("calibrate", "--write-board", page, "--square", 0.03, "--marker", 0.022, "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    # Five squares of 30 mm and two margins of a third of a square.
    assert abs(told["width_mm"] - (5 * 30 + 20)) < 0.2
    if suffix == "pdf":
        box = re.search(rb"MediaBox \[ 0 0 ([0-9.]+) ([0-9.]+)", page.read_bytes())
        assert box is not None
        assert abs(float(box[1]) / 72 * 25.4 - told["width_mm"]) < 0.2
        return
    with Image.open(page) as image:
        dots = image.info["dpi"][0] / 25.4
        found = find_board(np.asarray(image.convert("L")), CharucoBoard(5, 7, 0.03, 0.022))
    assert found is not None
    assert len(found.ids) == 24
    across = found.pixels[found.ids == 3] - found.pixels[found.ids == 0]
    assert np.allclose(across / dots, [90, 0], atol=0.1)


XYZW = TURN.as_quat()
WXYZ = [float(v) for v in (XYZW[3], *XYZW[:3])]
ROS = {
    "position": dict(zip("xyz", POSE[:3, 3].tolist(), strict=True)),
    "orientation": dict(zip("xyzw", XYZW.tolist(), strict=True)),
}
SEVEN = [*POSE[:3, 3].tolist(), *WXYZ]
LINE = ",".join(map(repr, SEVEN))
HEADER = "qx,qy,qz,qw,image,x,y,z"
SHUFFLED = ",".join(map(repr, [*XYZW.tolist(), "one.png", *POSE[:3, 3].tolist()])).replace("'", "")
POSE_FORMS: dict[str, tuple[str, bool]] = {
    "matrices.json": (json.dumps([POSE.tolist()]), False),
    "flat.json": (json.dumps([POSE.ravel().tolist()]), False),
    "seven.json": (json.dumps([SEVEN]), False),
    "named.json": (json.dumps({"one.png": SEVEN}), True),
    "inner.json": (json.dumps({"poses": [{"pose": ROS}]}), False),
    "ros.json": (json.dumps([{"image": "one.png", **ROS}]), True),
    "plain.csv": (LINE, False),
    "blanks.txt": (LINE.replace(",", " "), False),
    "named.csv": (f"one.png,{LINE}", True),
    "header.csv": (f"{HEADER}\n{SHUFFLED}\n", True),
    "empty_cells.csv": (f"note,{HEADER},more\n,{SHUFFLED},\n,,,\n", True),
    "empty_name.csv": (f",{HEADER},note\n7,{SHUFFLED}\n", True),
}


@pytest.mark.parametrize("name", POSE_FORMS)
def test_every_form_of_robot_poses_is_the_same_pose(tmp_path: Path, name: str) -> None:
    text, named = POSE_FORMS[name]
    (tmp_path / name).write_text(text)
    found = read_robot_poses(tmp_path / name)
    assert np.allclose(found.T_base_gripper, POSE[None], atol=1e-12)
    assert found.names == (("one.png",) if named else None)


def test_a_cell_without_end_is_no_csv(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f'{HEADER}\n"{"0" * 200_000}"\n')
    with pytest.raises(InputError, match="is no CSV"):
        read_robot_poses(tmp_path / "a.csv")


def change(option: str, *value: object) -> Callable[[Path], list[object]]:
    return lambda folder: [option, *value]


def keep(*names: str) -> Callable[[Path], list[object]]:
    """All other images are grey."""

    def spoil(folder: Path) -> list[object]:
        for image in (folder / "images").iterdir():
            if image.name not in names:
                Image.new("L", (HD.width, HD.height), 90).save(image)
        return []

    return spoil


def mirror(folder: Path) -> list[object]:
    for path in (folder / "images").iterdir():
        with Image.open(path) as image:
            turned = image.transpose(Image.Transpose.FLIP_LEFT_RIGHT)
        turned.save(path)
    return []


def poses(spoil: Callable[[list], object]) -> Callable[[Path], list[object]]:
    def write(folder: Path) -> list[object]:
        data = json.loads((folder / "fixed.json").read_text())
        (folder / "fixed.json").write_text(json.dumps(spoil(data)))
        return []

    return write


def about_one_axis(data: list) -> list:
    turns = Rotation.from_euler("z", np.linspace(0, 60, len(data))[:, None], degrees=True)
    return transform(turns.as_matrix(), np.zeros((len(data), 3))).tolist()


def other_size(folder: Path) -> list[object]:
    Image.new("L", (640, 480)).save(folder / "images" / "7.png")
    return []


MISTAKES: dict[str, tuple[Callable[[Path], list[object]], str]] = {
    "two images of the board": (keep("3.png", "11.png"), r"2 of 15 images \(3\.png, 11\.png\)"),
    "no board anywhere": (keep(), "0 of 15 images"),
    "mirrored images": (mirror, "mirrored"),
    "another dictionary": (change("--dictionary", "4X4_50"), "--dictionary 5X5_50"),
    "another board": (change("--squares", "9x7"), "up to number 16"),
    "a turned board": (change("--squares", "7x5"), "--squares 5x7"),
    "no such dictionary": (change("--dictionary", "ARUCO"), "allowed: 4X4_50"),
    "too small a dictionary": (change("--squares", "20x20"), "200 markers"),
    "squares in millimetres": (change("--square", "35"), "0.5 m"),
    "squares of words": (change("--squares", "five"), "such as 5x7"),
    "a pose too few": (poses(lambda data: data[1:]), "14 poses, and there are 15 images"),
    "a pose without an image's name": (
        poses(lambda data: {f"{i}.png": pose for i, pose in enumerate(data) if i != 6}),
        "no pose of 6.png",
    ),
    "one axis": (poses(about_one_axis), "about one axis"),
    "poses in millimetres": (
        poses(lambda data: [[[*r[:3], 1000 * r[3]] for r in p[:3]] + [p[3]] for p in data]),
        "--pose-unit mm",
    ),
    "poses of other images": (poses(lambda data: data[::-1]), "do not fit the images"),
    "poses that are none": (poses(lambda data: [[1, 2, 3]] * 15), "not a rotation and translation"),
    "the other arrangement": (change("--eye-in-hand"), "other arrangement"),
    "an image of another size": (other_size, "of one camera"),
    "--at of a fixed camera": (change("--at", "0,0,0,1,0,0,0"), "--eye-in-hand"),
    "a pose that is no JSON": (change("--out", "T.txt"), "T.json"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_what_cannot_be_used_is_one_message(
    rendered: Path, tmp_path: Path, cli: Callable, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    spoil, message = MISTAKES[name]
    shutil.copytree(rendered, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    done = cli(
        "calibrate", "images", "--intrinsics", "K.json", "--robot-poses", "fixed.json",
        *spoil(tmp_path),
    )  # fmt: skip
    assert done.code == 2
    assert re.search(message, done.err), done.err
    assert done.err.count("rgrasp: ") == 1
    assert not list(tmp_path.glob("T*"))


def test_what_is_missing_is_said(tmp_path: Path, cli: Callable) -> None:
    assert "--intrinsics and --robot-poses" in cli("calibrate").err
    asked = ("--intrinsics", "K.json", "--robot-poses", tmp_path / "p.json")
    assert "no such folder" in cli("calibrate", tmp_path / "none", *asked).err
    assert "holds no images" in cli("calibrate", tmp_path, *asked).err
    assert cli("calibrate", "--write-board", tmp_path / "board.svg").code == 2
