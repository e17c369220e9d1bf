"""Kinds of checkpoints by their config.json, without the seconds of imports that networks take."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, get_args

from pointsdf_cli.assets import assets_folder
from pointsdf_cli.choices import Model
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.checkpoints import read_config
from pointsdf_cli.robot.description import RobotDescription

ARCHITECTURE = "grasp-success"


def require_reconstructions(paths: Iterable[Path | None]) -> None:
    """Require reconstruction networks; None is passed over.

    Raises:
        InputError: One is no checkpoint, or of another kind.
    """
    for path in filter(None, paths):
        found = read_config(path).get("architecture")
        if found not in get_args(Model):
            raise InputError(
                f"is a {found}, not a reconstruction network",
                where=path,
                allowed=", ".join(get_args(Model)),
                hint="rgrasp train-sdf --views DIR --labels DIR --out CKPT",
            )


def require_successes(paths: Iterable[Path | None], robot: RobotDescription) -> None:
    """Require success networks of a robot; None is passed over.

    Raises:
        InputError: One is no checkpoint, of another kind, or learned with another robot.
    """
    for path in filter(None, paths):
        config = read_config(path)
        check_success(config, path)
        learned = config.get("robot")
        if isinstance(learned, Mapping) and {"name", "preshape_joints"} <= set(learned):
            check_robot(robot, learned["name"], learned["preshape_joints"], path)


def check_success(config: Mapping[str, Any], where: object) -> None:
    """Require the config.json of a success network.

    Raises:
        InputError: It is of another kind.
    """
    if config.get("architecture") != ARCHITECTURE:
        what = f"is a {config.get('architecture')}, not a success network"
        raise InputError(what, where=where, hint="rgrasp train-gs --grasps DIR --out CKPT")


def check_robot(
    robot: RobotDescription, name: str, preshape_joints: list[str] | tuple[str, ...], where: object
) -> None:
    """Refuse data made with another hand.

    Raises:
        InputError: The names differ.
    """
    if robot.name != name or list(robot.preshape_joints) != list(preshape_joints):
        raise InputError(
            f"was made with the robot {name!r} ({len(preshape_joints)} preshape joints), "
            f"not {robot.name!r} ({len(robot.preshape_joints)})",
            where=where,
            hint="give that robot's YAML with --robot; for another hand train a network with "
            "collect-grasps and train-gs --robot, and plan with --grasp-checkpoint",
        )


def bundled_success(robot: RobotDescription, inputs: str = "geometry") -> Path | None:
    """The bundled checkpoint that learned with a robot of this name; None if there is none.

    Args:
        robot: The robot.
        inputs: Inputs of its network, a key of `NETWORKS`.
    """
    wanted = ARCHITECTURE, inputs, robot.name
    for folder in sorted((assets_folder() / "weights").iterdir()):
        config = read_config(folder)
        learned = config.get("robot")
        name = learned.get("name") if isinstance(learned, Mapping) else None
        if (config.get("architecture"), config.get("inputs"), name) == wanted:
            return folder
    return None


def grasps_learned_from(config: Mapping[str, Any]) -> int | None:
    """Number of executed grasps that a checkpoint with this config.json was trained on; None if it
    does not say."""
    try:
        return int(config["data"]["train"]["grasps"])
    except (KeyError, TypeError, ValueError):
        return None
