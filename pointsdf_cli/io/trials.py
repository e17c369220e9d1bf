"""The `trials` artifact, a row a trial, and the `trial` artifact: one trial with its evidence."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.choices import Method
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.hdf5 import attributes_as_input_error, read_artifact, write_artifact
from pointsdf_cli.io.layout import Column

SCHEMA, VERSION = "trials", 3
TRIAL_SCHEMA, TRIAL_VERSION = "trial", 3
TRIAL_LAYOUT = {
    "cloud": Column("f4 [N, 3]", "m", "world"),
    "T_world_camera": Column("f8 [4, 4]", "m", "world"),
    "vertices": Column("f4 [V, 3]", "m", "world"),
    "faces": Column("i4 [F, 3]"),
    "phases": Column("S [*]"),
    "q": Column("f8 [M, J]", "rad or m", "joints"),
    "T_world_object": Column("f8 [M, 4, 4]", "m", "world"),
    "trajectory": Column("f8 [T, J]", "rad or m", "joints"),
    "times": Column("f8 [T]", "s"),
    "T_world_others": Column("f8 [M2, N2, 4, 4]", "m", "world"),
    "obstacle_vertices": Column("f4 [V2, 3]", "m", "world"),
    "obstacle_faces": Column("i4 [F2, 3]"),
}


@dataclass(frozen=True)
class TrialRow:
    """Result of one trial.

    Attributes:
        object: Name.
        yaw_index, repeat: Counters.
        yaw: Rotation of the object about the vertical [rad].
        camera: "high" or "low".
        method: "reconstruction" or "partial-view".
        ablation: Empty, or what was changed.
        status: "ok" or "no_plan".
        reason: Reason code without a plan, else empty.
        kind: "side" or "top"; empty without a plan.
        cause: "held", or how it ended: a cause of the executor, or "no_plan".
        planning_time: Wall time from the object's points to the trajectory [s]; 0 if none is seen.
        planning_cpu: The same in processor time [s], which the load of the machine hardly changes.
        success_probability: Predicted probability; NaN without a plan.
        contact: Whether the robot touched the object before the hand closed.
        moved: Displacement of the object by then [m].
        penetration: Depth of the planned grasp in the true mesh [m], 0 if none.
        lifted: Whether the object rose at least 0.105 m and was in the hand after the lift.
        held: Whether it was still in the hand after the hold; equal to `lifted` without a hold.
        unshaken: 1 if it was still in the hand after all pushes, 0 if not, -1 without pushes.
        lost_in: Step in which it was lost: "lift", "hold", "push +x" and so on; else empty, also
            without a plan.
        final_height: Rise of the object at the verdict `held` [m].
        seed: Random seed of the experiment.
        clutter: Number of other objects around.
        disturbed: Whether one of them fell over or moved more than 2 cm.
        largest_move: Largest displacement of one of them [m].
    """

    object: str
    yaw_index: int
    repeat: int
    yaw: float
    camera: str
    method: str
    ablation: str
    status: str
    reason: str
    kind: str
    cause: str
    planning_time: float
    planning_cpu: float
    success_probability: float
    contact: bool
    moved: float
    penetration: float
    lifted: bool
    held: bool
    unshaken: int
    lost_in: str
    final_height: float
    seed: int
    clutter: int = 0
    disturbed: bool = False
    largest_move: float = 0.0

    @property
    def succeeded(self) -> bool:
        """Whether the object was held and no other object disturbed."""
        return self.held and not self.disturbed


@dataclass(frozen=True)
class Evidence:
    """Data for drawing a trial.

    Attributes:
        cloud: f4 [N, 3], world, m.
        T_world_camera: [4, 4].
        vertices, faces: f4 [V, 3] world m, i4 [F, 3], the planner's surface of the object; empty
            without one.
        phases: [M], names of the moments shown.
        q: [M, J], the robot then.
        T_world_object: [M, 4, 4], the object then; M = 1 without an execution.
        trajectory: [T, J], the planned motion; T = 0 without one.
        times: [T], s.
        T_world_others: [M, N, 4, 4], the other objects then; N = 0 without clutter.
        obstacle_vertices, obstacle_faces: f4 [V, 3] world m, i4 [F, 3], the planner's surfaces of
            the other objects.
    """

    cloud: NDArray[np.float32]
    T_world_camera: Array
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    phases: tuple[str, ...]
    q: Array
    T_world_object: Array
    trajectory: Array
    times: Array
    T_world_others: Array = field(default_factory=lambda: np.zeros((0, 0, 4, 4)))
    obstacle_vertices: NDArray[np.float32] = field(
        default_factory=lambda: np.zeros((0, 3), dtype=np.float32)
    )
    obstacle_faces: NDArray[np.int32] = field(
        default_factory=lambda: np.zeros((0, 3), dtype=np.int32)
    )


_UNITS = {
    "yaw": "rad",
    "planning_time": "s",
    "planning_cpu": "s",
    "moved": "m",
    "penetration": "m",
    "final_height": "m",
    "largest_move": "m",
}
_LETTERS = {"str": "S", "int": "i8", "float": "f8", "bool": "b1"}
LAYOUT = {
    one.name: Column(_LETTERS[str(one.type)] + " [R]", _UNITS.get(one.name, ""))
    for one in fields(TrialRow)
}


def write_trial(
    path: Path | str, row: TrialRow, evidence: Evidence, config: Mapping[str, Any]
) -> None:
    """Write one trial as a whole."""
    write_artifact(
        path,
        schema=TRIAL_SCHEMA,
        version=TRIAL_VERSION,
        layout=TRIAL_LAYOUT,
        arrays=vars(evidence),
        attributes={"row_json": json.dumps(asdict(row))},
        seed=row.seed,
        config=config,
    )


def read_trial(path: Path | str) -> tuple[TrialRow, Evidence]:
    """Read one trial.

    Raises:
        InputError: Not a trial file of this version.
    """
    artifact = read_artifact(path, schema=TRIAL_SCHEMA, version=TRIAL_VERSION, names=TRIAL_LAYOUT)
    with attributes_as_input_error(path):
        row = _row(json.loads(str(artifact.attributes["row_json"])))
        data = artifact.values
        moments, phases = len(data["q"]), len(data["phases"])
        if moments < 1 or phases not in (0, moments):
            raise ValueError(f"{phases} phases of {moments} moments")
        _require_corners(data["faces"], data["vertices"])
        _require_corners(data["obstacle_faces"], data["obstacle_vertices"])
        if data["T_world_others"].size and len(data["T_world_others"]) != moments:
            raise ValueError("poses of other objects at other moments")
    return row, Evidence(**data)


def _require_corners(faces: NDArray[np.int32], vertices: NDArray[np.float32]) -> None:
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        raise ValueError("faces of vertices that are not there")


def _row(values: Mapping[str, Any]) -> TrialRow:
    """Row of a trial, from values whose types are checked.

    Raises:
        ValueError: A value is of another type, or an unknown method.
    """
    allowed: dict[str, tuple[type, ...]] = {
        "str": (str,), "int": (int,), "float": (int, float), "bool": (bool,),
    }  # fmt: skip
    for one in fields(TrialRow):
        if type(values[one.name]) not in allowed[str(one.type)]:
            raise ValueError(f"{one.name} is {values[one.name]!r}")
    if values["method"] not in get_args(Method):
        raise ValueError(f"method is {values['method']!r}")
    return TrialRow(**values)


def write_trials(
    path: Path | str, rows: Sequence[TrialRow], *, seed: int, config: Mapping[str, Any]
) -> None:
    """Write all rows as one table: a dataset a column.

    Raises:
        InputError: There are no rows.
    """
    if not rows:
        raise InputError("there are no trials", where=path)
    columns = {name: [getattr(row, name) for row in rows] for name in LAYOUT}
    write_artifact(path, SCHEMA, VERSION, LAYOUT, columns, seed=seed, config=config)


def read_trials(path: Path | str) -> list[TrialRow]:
    """Read a table of trials.

    Raises:
        InputError: Not a trials file of this version.
    """
    artifact = read_artifact(path, schema=SCHEMA, version=VERSION, names=LAYOUT)
    with attributes_as_input_error(path):
        values = artifact.values.items()
        columns = {name: v if isinstance(v, tuple) else v.tolist() for name, v in values}
        rows = zip(*columns.values(), strict=True)
        return [_row(dict(zip(columns, values, strict=True))) for values in rows]
