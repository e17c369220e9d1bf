"""Names that options accept, each set in one place, importable without any library."""

from collections.abc import Mapping
from typing import Any, Literal, get_args

from pointsdf_cli.errors import InputError

Dictionary = Literal[
    "4X4_50", "4X4_100", "4X4_250", "4X4_1000", "5X5_50", "5X5_100", "5X5_250", "5X5_1000",
    "6X6_50", "6X6_100", "6X6_250", "6X6_1000", "7X7_50", "7X7_100", "7X7_250", "7X7_1000",
]  # fmt: skip
Encoder = Literal["geometry", "pointsdf", "voxelcnn"]
Frame = Literal["camera", "world"]
GraspKind = Literal["auto", "side", "top"]
MeshFormat = Literal["ply", "obj", "stl", "glb"]
Method = Literal["reconstruction", "partial-view"]
Mode = Literal["fixed", "fine-tuned", "scratch"]
Model = Literal["pointsdf-ray", "pointsdf", "voxelcnn"]
Obstacles = Literal["reconstruction", "hull"]
Precision = Literal["auto", "bfloat16", "float32"]
Preshapes = Literal["heuristic", "planned"]
Preset = Literal["small", "paper"]
Segment = Literal["auto", "none"]
Sensor = Literal["ideal", "structured-light", "stereo"]
Solver = Literal["sqp", "slsqp"]
Unit = Literal["m", "cm", "mm", "inch"]

GRASP_KINDS = SIDE, TOP = ("side", "top")
"""Kinds of a grasp, by the side of the object from which the hand comes; files hold indices."""


def require_choice(value: str | None, choices: Any, option: str) -> None:
    """Require one of the names in a `Literal`, for values that no command line has checked.

    Raises:
        InputError: `value` is none of them; the message names the option.
    """
    known = get_args(choices)
    if value not in known:
        what = option.lstrip("-").replace("-", " ")
        raise InputError(f"no {what} {value!r}", where=option, allowed=", ".join(known))


def first_given(options: Mapping[str, object]) -> str | None:
    """Name of the first option that was given; the value of the others is None or False."""
    found = (name for name, value in options.items() if value is not None and value is not False)
    return next(found, None)
