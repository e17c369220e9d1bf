"""The `grasps` artifact: attempts to grasp one object, with their outcomes."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.choices import GRASP_KINDS
from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.visibility import ViewEvidence
from pointsdf_cli.io.hdf5 import (
    attributes_as_input_error,
    open_hdf5,
    options_of,
    read_artifact,
    write_artifact,
)
from pointsdf_cli.io.layout import Column
from pointsdf_cli.io.view_evidence import evidence_arrays, evidence_layout, read_view_evidence

SCHEMA, VERSION = "grasps", 2
LAYOUT = {
    "cloud": Column("f4 [G, P, 3]", "m", "camera"),
    "T_world_camera": Column("f8 [G, 4, 4]", "m", "world"),
    "T_world_object": Column("f8 [G, 4, 4]", "m", "world"),
    "T_world_palm": Column("f8 [G, 4, 4]", "m", "world"),
    "q": Column("f8 [G, J]", "rad or m", "joints"),
    "label": Column("i1 [G]"),
    "kind": Column("i1 [G]"),
    "cause": Column("i1 [G]"),
    "lift_height": Column("f4 [G]", "m", "world"),
    "slip": Column("f4 [G]", "m", "palm"),
    "attempt": Column("i4 [G]"),
    "scene": Column("i4 [G]"),
    "unshaken": Column("i1 [G]"),
}
EVIDENCE = evidence_layout("G")

HELD, LOST, NO_MOTION, NO_CONFIGURATION, INVALID = 1, 0, -1, -2, -3
"""Labels. A grasp counts as executed if it is held or lost; INVALID is a simulation that failed."""
CAUSES = (
    "held",
    "missed",
    "slipped",
    "dropped",
    "flung",
    "penetration",
    "no_ik",
    "start_in_table",
    "start_in_object",
    "start_in_self",
    "no_lift",
    "no_path",
    "no_plan",
)
SIMULATED = CAUSES[:6]
"""Causes of attempts that were carried out in simulation."""


@dataclass(frozen=True)
class Grasps:
    """G attempts with one object. `kind` and `cause` are indices into `GRASP_KINDS` and `CAUSES`.

    Attributes:
        cloud: f4 [G, 1000, 3], camera frame, m: the object as segmented from the view.
        T_world_camera, T_world_object, T_world_palm: f8 [G, 4, 4].
        q: f8 [G, J], the preshape; NaN for the arm where there is no inverse kinematics.
        label: i1 [G]: 1 held, 0 lost, -1 no motion plan, -2 no inverse kinematics or start in
            collision, -3 the simulation failed.
        kind: i1 [G].
        cause: i1 [G].
        lift_height: f4 [G], how much the object rose [m]; NaN where nothing was executed.
        slip: f4 [G], its motion in the palm's frame from grip to end [m]; NaN likewise.
        attempt, scene: i4 [G], counters within the object; attempts of a scene share pose and
            camera.
        unshaken: i1 [G]: 1 still held after pushes in six directions, 0 executed and not, -1 not
            pushed, not executed or not credible.
        evidence: G entries, what each view knows of the space around the object; empty if nothing
            is known of any.
    """

    cloud: NDArray[np.float32]
    T_world_camera: NDArray[np.float64]
    T_world_object: NDArray[np.float64]
    T_world_palm: NDArray[np.float64]
    q: NDArray[np.float64]
    label: NDArray[np.int8]
    kind: NDArray[np.int8]
    cause: NDArray[np.int8]
    lift_height: NDArray[np.float32]
    slip: NDArray[np.float32]
    attempt: NDArray[np.int32]
    scene: NDArray[np.int32]
    unshaken: NDArray[np.int8]
    evidence: tuple[ViewEvidence, ...] = ()

    def __len__(self) -> int:
        return len(self.label)

    @property
    def executed(self) -> NDArray[np.bool_]:
        """bool [G]: held or lost."""
        return np.asarray(self.label >= LOST)

    @property
    def simulated(self) -> NDArray[np.bool_]:
        """bool [G]: carried out in simulation. A planned grasp that begins in the object is not,
        though it counts as executed and lost."""
        return np.asarray(self.cause < len(SIMULATED))

    def count(self) -> dict[str, int]:
        """Number of attempts that ended in each cause, by the cause's name."""
        by_cause = np.bincount(self.cause, minlength=len(CAUSES))
        return {cause: int(n) for cause, n in zip(CAUSES, by_cause, strict=True)}


@dataclass(frozen=True)
class GraspsMeta:
    """Facts about the object of a grasps file.

    Attributes:
        mesh_file, mesh_hash: The mesh.
        split: "train" or "test".
        robot: Name of the robot.
        joint_names: The order of q.
        preshape_joints: The joints that a grasp chooses.
        complete: Whether the object has given all the attempts that it was asked for.
    """

    mesh_file: str
    mesh_hash: str
    split: str
    robot: str
    joint_names: tuple[str, ...]
    preshape_joints: tuple[str, ...]
    complete: bool = True


def write_grasps(
    path: Path | str,
    grasps: Grasps,
    meta: GraspsMeta,
    *,
    seed: int,
    config: Mapping[str, Any] | None = None,
) -> None:
    """Write all attempts with one object as one HDF5 file."""
    names = {"joint_names": list(meta.joint_names), "preshape_joints": list(meta.preshape_joints)}
    arrays = vars(grasps) | evidence_arrays(grasps.evidence, len(grasps))
    attributes = vars(meta) | names | {"kinds": list(GRASP_KINDS), "causes": list(CAUSES)}
    write_artifact(
        path,
        SCHEMA,
        VERSION,
        LAYOUT | EVIDENCE,
        arrays,
        attributes=attributes,
        seed=seed,
        config=config,
    )


def read_grasps(path: Path | str) -> tuple[Grasps, GraspsMeta]:
    """Read a grasps file.

    Raises:
        InputError: Not a grasps file of this version.
    """
    artifact = read_artifact(path, schema=SCHEMA, version=VERSION, names=LAYOUT | EVIDENCE)
    attributes, datasets = artifact.attributes, artifact.datasets
    evidence = read_view_evidence(path, datasets)
    grasps = Grasps(**{name: datasets[name] for name in LAYOUT}, evidence=evidence)
    indices = ("kind", grasps.kind, GRASP_KINDS), ("cause", grasps.cause, CAUSES)
    for name, values, known in indices:
        if len(values) and not 0 <= values.min() <= values.max() < len(known):
            what = f"{name} runs from {values.min()} to {values.max()}"
            raise InputError(what, where=path, allowed=f"0 to {len(known) - 1}: {', '.join(known)}")
    with attributes_as_input_error(path):
        meta = GraspsMeta(
            mesh_file=str(attributes["mesh_file"]),
            mesh_hash=str(attributes["mesh_hash"]),
            split=str(attributes["split"]),
            robot=str(attributes["robot"]),
            joint_names=tuple(str(name) for name in attributes["joint_names"]),
            preshape_joints=tuple(str(name) for name in attributes["preshape_joints"]),
            complete=bool(attributes["complete"]),
        )
        if len(meta.joint_names) != grasps.q.shape[1]:
            raise ValueError(f"{len(meta.joint_names)} joints, q of {grasps.q.shape[1]}")
    return grasps, meta


def collection_of(path: Path | str) -> Mapping[str, Any]:
    """Options of `collect-grasps` that made a file: `robot` is the robot's digest, `preshapes` is
    there if a planner chose the grasps. Empty if something else wrote it.

    Raises:
        InputError: It is no artifact, or a damaged one.
    """
    with open_hdf5(path) as file:
        return options_of(file)


def join_grasps(parts: list[Grasps]) -> Grasps:
    """Several runs of attempts as one."""
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in LAYOUT}
    known = [part.evidence or (ViewEvidence(),) * len(part) for part in parts]
    return Grasps(**arrays, evidence=tuple(itertools.chain(*known)))
