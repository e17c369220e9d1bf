"""`rgrasp calibrate`: pose of the camera, from images of a board."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pointsdf_cli import choices
from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError

if TYPE_CHECKING:
    from pointsdf_cli.camera.calibration import Calibration
    from pointsdf_cli.camera.charuco import CharucoBoard

BOARD_SUFFIXES = (".pdf", ".png")
PIXELS_A_SQUARE = 420
LARGE_PIXELS, LARGE_MILLIMETRES = 1.0, 3.0  # rms; good images have 0.1 px, good robots 1 mm


def calibrate(
    images: Annotated[Path | None, typer.Argument(help="Folder of images of the board.")] = None,
    intrinsics: Annotated[
        str | None,
        typer.Option(
            metavar="K.json",
            help="Camera intrinsics as for rgrasp cloud; may include OpenCV's distortion.",
        ),
    ] = None,
    robot_poses: Annotated[
        Path | None,
        typer.Option(
            metavar="POSES",
            help="Gripper in the robot's root frame, one pose an image, in the order of the "
            "images' names or with their names: JSON or CSV.",
        ),
    ] = None,
    eye_in_hand: Annotated[
        bool,
        typer.Option(
            "--eye-in-hand",
            help="Camera on the wrist, board fixed. Without it: camera fixed, board in the "
            "gripper.",
        ),
    ] = False,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="POSE",
            help="With --eye-in-hand: a pose of the gripper in the robot's root frame; the output "
            "is the camera's pose with the gripper there.",
        ),
    ] = None,
    squares: Annotated[str, typer.Option(help="Size of the board: columns x rows.")] = "5x7",
    square: Annotated[float, typer.Option(help="Side of a square, as measured [m].")] = 0.035,
    marker: Annotated[float, typer.Option(help="Side of a marker [m].")] = 0.026,
    dictionary: Annotated[
        choices.Dictionary,
        typer.Option(metavar="NAME", help="ArUco dictionary of the markers: 4X4_50 to 7X7_1000."),
    ] = "5X5_100",
    legacy_board: Annotated[
        bool, typer.Option("--legacy-board", help="Board layout of OpenCV before 4.6.")
    ] = False,
    pose_unit: Annotated[
        choices.Unit, typer.Option(help="Unit of the robot's translations, also in --at.")
    ] = "m",
    robot: common.Robot = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output pose [default: T_world_camera.json; with --eye-in-hand and without "
            "--at T_gripper_camera.json]."
        ),
    ] = None,
    write_board: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Only write the board to print: PDF or PNG, to scale."),
    ] = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Find the camera's pose from images of a ChArUco board and the robot's poses.

    Example: rgrasp calibrate images/ --intrinsics K.json --robot-poses poses.json
    """
    from pointsdf_cli.camera.calibration import calibrate_from_files
    from pointsdf_cli.camera.charuco import CharucoBoard
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_new, require_place
    from pointsdf_cli.io.board_images import list_images
    from pointsdf_cli.io.meshes import UNITS
    from pointsdf_cli.io.poses import camera_pose, write_pose
    from pointsdf_cli.robot.description import load_robot

    reporter = common.Reporter(quiet, as_json)
    board = CharucoBoard(*_squares(squares), square, marker, dictionary, legacy_board)
    if write_board is not None:
        common.check_suffix(write_board, "--write-board", BOARD_SUFFIXES)
        _write_board(reporter, require_new(write_board, force), board)
        return
    if images is None or intrinsics is None or robot_poses is None:
        raise InputError(
            "needs IMAGES, --intrinsics and --robot-poses, or --write-board",
            where="rgrasp calibrate",
            hint="rgrasp calibrate images/ --intrinsics K.json --robot-poses poses.json",
        )
    if at is not None and not eye_in_hand:
        raise InputError("--at without --eye-in-hand", hint="leave it out: the camera stands still")
    placed = None
    if at is not None:
        placed = camera_pose(at, "--at", "the gripper", UNITS[pose_unit])
    name = "T_gripper_camera" if eye_in_hand and placed is None else "T_world_camera"
    out = out or Path(f"{name}.json")
    require_apart([out], [robot_poses, intrinsics, at, robot])
    require_place(out, force)
    common.check_suffix(out, "--out", (".json",))
    T_world_base = load_robot(robot).T_world_base
    with reporter.progress("images", len(list_images(images))) as progress:
        found = calibrate_from_files(
            images, intrinsics, robot_poses, board, eye_in_hand, pose_unit, progress.advance
        )
    pose = found.hand_eye.X
    if not eye_in_hand:
        pose = T_world_base @ pose
    elif placed is not None:
        pose = T_world_base @ placed @ pose
    write_pose(out, pose)
    values = _values(found)
    if values["error_px"] > LARGE_PIXELS or values["error_mm"] > LARGE_MILLIMETRES:
        values["warnings"] = [
            "images and robot's poses disagree, so the camera's pose may be centimetres wrong: "
            "check --square as measured, the intrinsics with their distortion, and the poses"
        ]
        reporter.warn(*values["warnings"])
    facts = {"out": out, name: pose, "eye_in_hand": eye_in_hand}
    reporter.result({**facts, **values}, _lines(values, out, name))


def _squares(text: str) -> tuple[int, int]:
    from pointsdf_cli.io.untrusted import is_whole_number

    sides = text.lower().replace("×", "x").split("x")
    if len(sides) != 2 or not all(is_whole_number(side.strip()) for side in sides):
        raise InputError(f"{text!r} squares", where="--squares", allowed="such as 5x7")
    return int(sides[0]), int(sides[1])


def _write_board(reporter: common.Reporter, path: Path, board: CharucoBoard) -> None:
    from pointsdf_cli.camera.charuco import draw_board
    from pointsdf_cli.io.board_images import write_board_page

    drawn = draw_board(board, PIXELS_A_SQUARE, PIXELS_A_SQUARE // 3)
    caption = f"{board}. Print at 100%, measure a square.".replace("×", "x")  # the font lacks ×
    width, height = write_board_page(path, drawn, PIXELS_A_SQUARE / board.square, caption)
    values = {"board": path, "width_mm": 1000 * width, "height_mm": 1000 * height}
    lines = [
        f"{path}: {board}; {1000 * width:.0f} × {1000 * height:.0f} mm with its margin",
        "print it at 100% (no fitting to the page), glue it to something flat, measure a "
        "square, and give that as --square",
    ]
    reporter.result(values, lines)


def _values(found: Calibration) -> dict[str, Any]:
    solved, used = found.hand_eye, found.hand_eye.used
    errors = {name: getattr(solved, name) for name in ("error_px", "error_mm", "error_deg")}
    columns = {"image": found.images, "corners": found.corners, **errors, "used": used.tolist()}
    rows = zip(*columns.values(), strict=True)
    return {
        "images_used": int(used.sum()),
        "outliers": found.outliers,
        "warnings": [],
        "without_board": found.without_board,
        "poses_matched_by": "name" if found.matched_by_name else "order",
        **{name: _rms(each[used]) for name, each in errors.items()},
        "sigma_mm": solved.sigma_mm,
        "sigma_deg": solved.sigma_deg,
        "T_target_board": solved.Z,
        "images": [dict(zip(columns, row, strict=True)) for row in rows],
    }


def _lines(values: Mapping[str, Any], out: Path, name: str) -> list[str]:
    def errors(of: Mapping[str, float]) -> tuple[str, str, str]:
        return f"{of['error_px']:.2f} px", f"{of['error_mm']:.2f} mm", f"{of['error_deg']:.2f}°"

    pixels, millimetres, degrees = errors(values)
    lines = [
        f"{out}: {name} from {values['images_used']} images: the robot's poses place the board "
        f"within {pixels}, {millimetres} and {degrees} of where the images show it (rms)",
        f"standard deviation of the camera's pose: {values['sigma_mm']:.2f} mm, "
        f"{values['sigma_deg']:.3f}°",
    ]
    for each in values["images"]:
        told = "" if each["used"] else "   does not fit, left out: was the robot there?"
        seen = f"{each['corners']} corners, {', '.join(errors(each))}"
        lines.append(f"  {each['image']}: {seen}{told}")
    lines += [f"  {image}: no board found, left out" for image in values["without_board"]]
    if values["poses_matched_by"] == "order":
        lines.append("poses and images were matched by their order: give names to be sure")
    if name == "T_gripper_camera":
        lines.append(
            "for --camera-pose: T_world_camera = T_world_gripper · T_gripper_camera at each "
            "image's robot pose; --at POSE writes it"
        )
    return lines


def _rms(values: object) -> float:
    import numpy as np

    return float(np.sqrt(np.mean(np.square(np.asarray(values, dtype=np.float64)))))
