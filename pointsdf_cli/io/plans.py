"""The `plan` artifact: a grasp with its motion, or the reason why there is none; and its JSON
forms."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.hdf5 import attributes_as_input_error, read_artifact, write_artifact
from pointsdf_cli.io.layout import Column
from pointsdf_cli.io.strict_json import plain

SCHEMA, VERSION = "plan", 1
LAYOUT = {
    "joint_names": Column("S [J]"),
    "q": Column("f8 [J]", "rad or m"),
    "trajectory": Column("f8 [T, J]", "rad or m"),
    "times": Column("f8 [T]", "s"),
    "lift": Column("f8 [K, *]", "rad or m"),
    "T_world_palm": Column("f8 [4, 4]", "m", "world"),
    "link_names": Column("S [L]"),
    "link_clearance_object": Column("f8 [L]", "m"),
    "link_clearance_table": Column("f8 [L]", "m"),
    "rejected_q": Column("f8 [R, J]", "rad or m"),
    "rejected_reason": Column("S [R]"),
    "rejected_success_probability": Column("f8 [R]"),
    "rejected_objective": Column("f8 [R]"),
    "rejected_slack": Column("f8 [R, 4]", "m"),
    "accepted_q": Column("f8 [A, *]", "rad or m"),
    "accepted_kind": Column("S [A]"),
    "accepted_success_probability": Column("f8 [A]"),
    "accepted_objective": Column("f8 [A]"),
}
OPTIONAL = {
    "object_vertices": Column("f4 [V, 3]", "m", "world", compress=True),
    "object_faces": Column("i4 [F, 3]", compress=True),
}
"""The object's surface; absent from plans that were made without it."""
ATTRIBUTES: dict[str, type] = {
    "status": str, "reason": str, "sentence": str, "kind": str,
    "success_probability": float, "objective": float, "seeds_tried": int,
}  # fmt: skip
"""Attributes, with their types."""
JSON_FIELDS = (
    *("status", "reason", "sentence", "kind", "joint_names", "q", "T_world_palm"),
    *("success_probability", "objective", "seeds_tried", "timings", "trajectory", "times", "lift"),
)
"""Fields of a plan that its JSON form repeats unchanged."""
OK, NO_PLAN = "ok", "no_plan"
SLACKS = ("object", "table", "obstacles", "self")


@dataclass(frozen=True)
class RejectedSeeds:
    """Solutions of the solver that were not accepted, R of them.

    Attributes:
        q: f8 [R, J].
        reasons: [R], reason codes.
        success_probability: f8 [R].
        objective: f8 [R].
        slack: f8 [R, 4], distances minus clearances to `SLACKS` [m]; negative is too near.
    """

    q: Array
    reasons: tuple[str, ...]
    success_probability: Array
    objective: Array
    slack: Array


@dataclass(frozen=True)
class AcceptedGrasps:
    """Every accepted grasp, best first, A of them. The plan's is the first, but for a plan with a
    warning: a fallback was not accepted.

    Attributes:
        q: f8 [A, J].
        kinds: [A], "side" or "top".
        success_probability, objective: f8 [A].
    """

    q: Array
    kinds: tuple[str, ...]
    success_probability: Array
    objective: Array

    @classmethod
    def none(cls, joints: int = 0) -> AcceptedGrasps:
        """Empty result: no grasp was accepted."""
        return cls(np.zeros((0, joints)), (), np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class Plan:
    """One answer of the planner, for J joints.

    Attributes:
        status: `ok` or `no_plan`.
        reason: Reason code; empty if the status is `ok`.
        sentence: The reason in words; for a plan a warning, or empty.
        joint_names: [J], order of the joints in every configuration.
        q: f8 [J], the grasp; NaN without one.
        trajectory: f8 [T, J], the motion to it; T = 0 without one.
        times: f8 [T], time of each configuration, s.
        T_world_palm: f8 [4, 4] of the grasp; NaN without one.
        success_probability, objective: Values of the grasp, or NaN.
        seeds_tried: Starts given to the solver.
        timings: Seconds by stage.
        link_names: [L].
        link_clearance_object, link_clearance_table: f8 [L] m, at the grasp; the first at samples of
            the link's surface, and beyond 3 cm to a box around the object.
        rejected: Every rejected seed with its residuals.
        kind: "side" or "top"; empty without a grasp.
        accepted: The grasp and its alternatives; without it if it is a fallback.
        lift: f8 [K, J], path from the grasp that raises the palm by 15 cm with the hand's joints
            unchanged; K = 0 if there is none.
        object_vertices: f4 [V, 3], world, m: the surface that constrains the plan; V = 0 without
            one.
        object_faces: i4 [F, 3], its triangles, seen counter-clockwise from outside.
    """

    status: str
    reason: str
    sentence: str
    joint_names: tuple[str, ...]
    q: Array
    trajectory: Array
    times: Array
    T_world_palm: Array
    success_probability: float
    objective: float
    seeds_tried: int
    timings: Mapping[str, float]
    link_names: tuple[str, ...]
    link_clearance_object: Array
    link_clearance_table: Array
    rejected: RejectedSeeds = field(repr=False)
    kind: str = ""
    accepted: AcceptedGrasps = field(default_factory=AcceptedGrasps.none, repr=False)
    lift: Array = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    object_vertices: NDArray[np.float32] = field(
        default_factory=lambda: np.zeros((0, 3), np.float32), repr=False
    )
    object_faces: NDArray[np.int32] = field(
        default_factory=lambda: np.zeros((0, 3), np.int32), repr=False
    )

    def __post_init__(self) -> None:
        joints = len(self.joint_names)
        if self.status not in (OK, NO_PLAN) or (self.status == OK) == bool(self.reason):
            raise InputError(
                f"a plan with status {self.status!r} and reason {self.reason!r}",
                allowed="ok without a reason, or no_plan with one",
            )
        if self.q.shape != (joints,) or self.trajectory.shape != (len(self.times), joints):
            raise InputError("the plan's arrays do not fit its joints", allowed="q [J], [T, J]")
        if len(self.lift) and self.lift.shape[1] != joints:
            raise InputError("the plan's lift does not fit its joints", allowed="[K, J]")
        faces = self.object_faces
        if faces.size and not 0 <= faces.min() <= faces.max() < len(self.object_vertices):
            raise InputError("the object's faces name vertices that it has not", allowed="0 to V")


def write_plan(
    path: Path | str, plan: Plan, *, seed: int, config: Mapping[str, Any] | None = None
) -> None:
    """Write a plan as one HDF5 file."""
    arrays = {
        **vars(plan),
        **{f"rejected_{name}": value for name, value in vars(plan.rejected).items()},
        **{f"accepted_{name}": value for name, value in vars(plan.accepted).items()},
        "rejected_reason": plan.rejected.reasons,
        "accepted_kind": plan.accepted.kinds,
    }
    attributes = {name: getattr(plan, name) for name in ATTRIBUTES} | {
        "timings_json": json.dumps(dict(plan.timings), sort_keys=True),
        "rejected_slack_columns": ",".join(SLACKS),
    }
    write_artifact(
        path,
        SCHEMA,
        VERSION,
        LAYOUT | OPTIONAL,
        arrays,
        attributes=attributes,
        seed=seed,
        config=config,
    )


def read_plan(path: Path | str) -> Plan:
    """Read a plan file.

    Raises:
        InputError: Not a plan of this version.
    """
    artifact = read_artifact(path, schema=SCHEMA, version=VERSION, names=LAYOUT, optional=OPTIONAL)
    facts = artifact.attributes
    with attributes_as_input_error(path):
        data = artifact.values
        return Plan(
            **{name: of(facts[name]) for name, of in ATTRIBUTES.items()},
            **{name: data[name] for name in Plan.__dataclass_fields__ if name in data},
            timings=dict(json.loads(facts["timings_json"])),
            # The layout has their datasets in the order of their fields.
            rejected=RejectedSeeds(*(data[name] for name in LAYOUT if name.startswith("rejected"))),
            accepted=AcceptedGrasps(
                *(data[name] for name in LAYOUT if name.startswith("accepted"))
            ),
        )


def plan_as_json(plan: Plan) -> dict[str, Any]:
    """The plan in plain types, as `--json` prints it; missing values are null."""
    rejected, accepted = plan.rejected, plan.accepted
    clearances = _rows(object=plan.link_clearance_object, table=plan.link_clearance_table)
    told: dict[str, Any] = plain(
        {
            **{name: getattr(plan, name) for name in JSON_FIELDS},
            **({} if plan.status == OK else {"q": None, "T_world_palm": None}),
            "link_clearance": dict(zip(plan.link_names, clearances, strict=True)),
            "accepted": _rows(
                kind=accepted.kinds,
                success_probability=accepted.success_probability,
                objective=accepted.objective,
                q=accepted.q,
            ),
            "rejected": _rows(
                reason=rejected.reasons,
                success_probability=rejected.success_probability,
                objective=rejected.objective,
                slack=[dict(zip(SLACKS, row, strict=True)) for row in rejected.slack],
                q=rejected.q,
            ),
        }
    )
    return told


def _rows(**columns: Iterable[Any]) -> list[dict[str, Any]]:
    """The rows of columns of one length, each by the columns' names."""
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
