"""`rgrasp robot`: check a robot's description, or begin one from a URDF."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError

if TYPE_CHECKING:
    from pointsdf_cli.robot.check import RobotCheck
    from pointsdf_cli.robot.description import RobotDescription

app = typer.Typer(help="Check a robot's description, or start one.", no_args_is_help=True)


@app.command()
def check(
    robot: Annotated[
        Path,
        typer.Argument(
            help="Robot YAML beside its URDF, panda, ur5e_2f85 or lbr4_barrett.",
            callback=common.bundled_robot,
        ),
    ],
    picture: Annotated[
        Path | None, typer.Option(help="Draw frames, fingertip paths and surface samples (PNG).")
    ] = None,
    seed: common.Seed = 0,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Read a robot's description, test it, and report problems with their fixes.

    Example: rgrasp robot check my_robot.yaml --picture my_robot.png
    """
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import atomic_path
    from pointsdf_cli.robot.description import load_robot

    reporter = common.Reporter(quiet, as_json)
    require_apart([picture], [robot])
    common.check_picture(picture, force)
    described = load_robot(robot)

    # Seconds of imports: only for a robot that can be read.
    from pointsdf_cli.robot.check import check_robot

    found = check_robot(described, seed)
    if picture:
        from PIL import Image

        from pointsdf_cli.viz.robot_check_picture import check_picture

        image = check_picture(described)
        with atomic_path(picture) as temporary:
            Image.fromarray(image).save(temporary, format="png")
    reporter.result(_values(described, found, picture), _lines(described, found, picture))
    errors = sum(finding.level == "error" for finding in found.findings)
    if errors:
        what = f"{errors} error{'s' * (errors != 1)} in the robot's description, listed above"
        raise InputError(what, where=robot)
    reporter.say("no errors")


@app.command()
def init(
    urdf: Annotated[Path, typer.Argument(help="A robot's URDF: an arm with a hand.")],
    out: Annotated[
        Path | None, typer.Option(help="Output YAML.  [default: beside the URDF]")
    ] = None,
    palm: Annotated[
        str | None,
        typer.Option(
            metavar="LINK", help="Link that carries the fingers.  [default: where they branch off]"
        ),
    ] = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    as_json: common.Json = False,
) -> None:
    """Write a first description of a robot from its URDF, with guesses marked for you to check.

    Example: rgrasp robot init my_robot.urdf
    """
    from pointsdf_cli.io.atomic import require_new, write_text_atomic
    from pointsdf_cli.robot.first_guess import as_yaml, first_guess
    from pointsdf_cli.robot.urdf import read_urdf

    reporter = common.Reporter(quiet, as_json)
    read_urdf(urdf)  # report an invalid URDF before checking the output path
    out = require_new(out or urdf.with_suffix(".yaml"), force, [urdf])
    data = first_guess(urdf, out, palm)
    write_text_atomic(out, as_yaml(data))
    arm, hand = len(data["arm_joints"]), len(data["hand_joints"])
    closing = len(data["closing_joints"])
    palm = data["palm"]["link"]
    line = (
        f"{out}: {arm} arm joints to {palm}, {hand} hand joints beyond it, {closing} of them close"
    )
    reporter.result({"out": out, **data}, [line])
    reporter.say(
        "check what is marked GUESSED there:\n"
        f"  rgrasp robot check {out} --picture {out.with_suffix('.png')}"
    )


def _values(robot: RobotDescription, found: RobotCheck, picture: Path | None) -> dict[str, object]:
    tips = zip(found.closing.tips, found.closing.paths[0], found.closing.paths[-1], strict=True)
    return {
        "robot": robot.name,
        "passed": found.passed,
        "arm_joints": list(robot.arm_joints),
        "hand_joints": list(robot.hand_joints),
        "fingertips": {tip: {"open": start, "closed": end} for tip, start, end in tips},
        "nearer": found.closing.nearer,
        "samples": found.samples,
        "farthest": found.farthest,
        "reached": found.reached,
        "self_distance": found.self_distance,
        "table_distance": found.table_distance,
        "findings": [asdict(finding) for finding in found.findings],
        "picture": picture,
    }


def _lines(robot: RobotDescription, found: RobotCheck, picture: Path | None) -> list[str]:
    tips = zip(found.closing.tips, found.closing.paths[0], found.closing.paths[-1], strict=True)
    return [
        f"{robot.name}: {len(robot.arm_joints)} arm joints, "
        f"{len(robot.hand_joints)} hand joints, {len(robot.preshape_joints)} of them "
        "chosen by a grasp",
        f"fingertips: {', '.join(found.closing.tips)}; from open to closed, in the palm's "
        "frame [m]:",
        *(f"  {tip}: ({_numbers(start)}) to ({_numbers(end)})" for tip, start, end in tips),
        f"at home: {_length(found.self_distance)} between links, "
        f"{_length(found.table_distance)} above the table",
        f"inverse kinematics: {found.reached:.0%} of palm poses that the arm can take",
        f"surface: {found.samples} samples, no point farther than "
        f"{found.farthest * 1e3:.1f} mm from one",
        *(f"{f.level}: {f.what}\n  try: {f.fix}" for f in found.findings),
        *([f"{picture}: written"] if picture else []),
    ]


def _numbers(values: object) -> str:
    return ", ".join(f"{float(v):.3f}" for v in values)  # type: ignore[attr-defined]


def _length(metres: float) -> str:
    return f"{metres * 1e3:.1f} mm" if metres < 1 else f"{metres:.2f} m"
