"""Executed grasps for the success network, split by object.

Only executed grasps are read: held is 1; lost, be it in a push, is 0. For a grasp without inverse
kinematics or without a motion the outcome is unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.arrays import Array
from pointsdf_cli.io.grasps import HELD, collection_of, read_grasps
from pointsdf_cli.io.hdf5 import artifacts_below
from pointsdf_cli.models.checkpoint_kinds import check_robot
from pointsdf_cli.robot.description import RobotDescription
from pointsdf_cli.robot.kinematics import Kinematics


@dataclass(frozen=True)
class GraspData:
    """N executed grasps of O objects; heuristic and planned grasps of an object are two files.

    Attributes:
        names: Paths of the files in the folder, without suffix.
        files: The files, in the order of their grasps.
        meshes: SHA-256 of the mesh files of the O objects.
        held_out: bool [O], objects excluded from training success networks. The reconstruction
            network may have been trained on their shapes.
        object_of: int [N], the object of each grasp.
        planned: bool [N], whether a planner chose the grasp, and not the heuristic.
        scene_of: int [N], numbered over all objects; grasps of a scene share pose and view.
        preshape: f8 [N, K], rad.
        T_world_palm, T_world_camera: f8 [N, 4, 4].
        cloud: f4 [N, P, 3], camera frame, m.
        kind: i1 [N], 0 side, 1 top.
        label: f4 [N], 1 held and not lost in a push, 0 lost.
    """

    names: list[str]
    files: list[Path]
    meshes: list[str]
    held_out: NDArray[np.bool_]
    object_of: NDArray[np.int64]
    planned: NDArray[np.bool_]
    scene_of: NDArray[np.int64]
    preshape: NDArray[np.float64]
    T_world_palm: NDArray[np.float64]
    T_world_camera: NDArray[np.float64]
    cloud: NDArray[np.float32]
    kind: NDArray[np.int8]
    label: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.label)

    @property
    def base_rate(self) -> float:
        """Share of grasps that held."""
        return float(self.label.mean())


@dataclass(frozen=True)
class Split:
    """Split of the grasps by object.

    Attributes:
        train, validation, test: int [n], indices of grasps.
        folds: [N], fold of each grasp; None without folds. With folds, `train` and `validation` are
            the same grasps, and fold m validates member m of an ensemble.
    """

    train: NDArray[np.int64]
    validation: NDArray[np.int64]
    test: NDArray[np.int64]
    folds: NDArray[np.int64] | None = None

    def describe(self) -> str:
        """Describe the numbers of grasps in words."""
        apart = "in folds of objects" if self.folds is not None else "of other objects"
        return (
            f"{len(self.train)} grasps to train on, {len(self.validation)} to validate on, {apart}"
        )


def read_grasp_data(folder: Path | str, robot: RobotDescription) -> GraspData:
    """Read a folder that `collect-grasps` wrote.

    Raises:
        InputError: No executed grasp, a file of another schema or another robot, or pushes that
            differ between files.
    """
    folder = Path(folder)
    kinematics = Kinematics(robot)
    kept: list[Path] = []
    held_out: dict[str, bool] = {}
    rows = []
    scenes = 0
    pushes: dict[float, Path] = {}
    for file in artifacts_below(folder):
        grasps, meta = read_grasps(file)
        check_robot(robot, meta.robot, meta.preshape_joints, file)
        chosen = np.flatnonzero(grasps.executed)
        if not len(chosen):
            continue
        collection = collection_of(file)
        if "robot" in collection:
            _require_palm(kinematics, grasps.q[chosen[0]], grasps.T_world_palm[chosen[0]], file)
        _require_one_push(pushes, file, collection.get("execution"))
        held_out[meta.mesh_hash] = held_out.get(meta.mesh_hash, False) or meta.split == "test"
        number = list(held_out).index(meta.mesh_hash)
        columns = [meta.joint_names.index(joint) for joint in meta.preshape_joints]
        scene = np.unique(grasps.scene[chosen], return_inverse=True)[1]
        succeeded = (grasps.label[chosen] == HELD) & (grasps.unshaken[chosen] != 0)
        rows.append(
            {
                "object_of": np.full(len(chosen), number),
                "planned": np.full(len(chosen), "preshapes" in collection),
                "scene_of": scene + scenes,
                "preshape": grasps.q[chosen][:, columns],
                "T_world_palm": grasps.T_world_palm[chosen],
                "T_world_camera": grasps.T_world_camera[chosen],
                "cloud": grasps.cloud[chosen],
                "kind": grasps.kind[chosen],
                "label": succeeded.astype(np.float32),
            }
        )
        scenes += int(scene.max()) + 1
        kept.append(file)
    if not rows:
        raise InputError("holds no executed grasp", where=folder, hint="collect more of them")
    names = [file.relative_to(folder).with_suffix("").as_posix() for file in kept]
    joined = {field: np.concatenate([row[field] for row in rows]) for field in rows[0]}
    return GraspData(names, kept, list(held_out), np.array(list(held_out.values())), **joined)


def _require_one_push(pushes: dict[float, Path], file: Path, execution: Any) -> None:
    """Require one push for all files: what counts as success must not depend on the file.

    Args:
        pushes: The first file with each push [N]; `file` is added.
        file: The next file.
        execution: Its options of the execution; None if something else wrote the file.

    Raises:
        InputError: Another push than in the files before.
    """
    if isinstance(execution, Mapping):
        pushes.setdefault(float(execution.get("push", 0.0)), file)
    if len(pushes) > 1:
        (before, first), (push, _) = pushes.items()
        raise InputError(
            f"was collected with --push {push:g}, {first} with --push {before:g}: success "
            "means two things",
            where=file,
            hint="read folders of one kind: --grasps FOLDER",
        )


PALM_OFF = 2e-3
"""Largest difference [m, and of unit axes] of palm frames that count as the same."""


def _require_palm(kinematics: Kinematics, q: Array, T_world_palm: Array, file: Path) -> None:
    """Require that the robot's description still gives the stored palm poses.

    Raises:
        InputError: It gives other ones.
    """
    now = kinematics.palm(q).numpy()
    if not np.allclose(now, T_world_palm, atol=PALM_OFF):
        away = 1000 * float(np.linalg.norm(now[:3, 3] - T_world_palm[:3, 3]))
        raise InputError(
            f"was made with another description of this robot: the palm is {away:.0f} mm off",
            where=file,
            hint="collect-grasps again with this --robot, or use the former description",
        )


def split_grasps(data: GraspData, validation: float, seed: int) -> Split:
    """Split by object: held-out objects are the test; a share of the others is for validation.

    Args:
        data: The grasps.
        validation: Share for validation of the objects that are not held out.
        seed: Random seed of the split.

    Raises:
        InputError: Too few objects, or grasps of one label only in training or validation.
    """
    count = max(1, round(validation * int((~data.held_out).sum())))
    chosen = _objects_to_learn(data, count, seed)
    validates = np.isin(data.object_of, chosen[:count])
    trains = np.isin(data.object_of, chosen[count:])
    _check_both_labels(data.label[trains], "train on")
    _check_both_labels(data.label[validates], "validate on")
    tests = data.held_out[data.object_of]
    return Split(*map(np.flatnonzero, (trains, validates, tests)))


def fold_grasps(data: GraspData, folds: int, seed: int) -> Split:
    """Split by folds: every object that is not held out validates one member and trains the others.

    With fewer objects than folds some folds are empty; their members train on all objects.

    Raises:
        InputError: Fewer than two objects, or grasps of one label only.
    """
    free = _objects_to_learn(data, 1, seed)
    fold_of = np.full(len(data.held_out), -1)
    fold_of[free] = np.arange(len(free)) % folds
    rows = np.flatnonzero(~data.held_out[data.object_of])
    _check_both_labels(data.label[rows], "train on")
    return Split(rows, rows, np.flatnonzero(data.held_out[data.object_of]), fold_of[data.object_of])


def _objects_to_learn(data: GraspData, validating: int, seed: int) -> NDArray[np.int64]:
    """The objects that are not held out, in random order; more than validate, and two at least."""
    free = np.flatnonzero(~data.held_out)
    if len(free) < max(2, validating + 1):
        raise InputError(
            f"{len(free)} objects to train on", where="--grasps", allowed="at least 2 objects"
        )
    return np.random.default_rng([seed, 7]).permutation(free)


def _check_both_labels(label: NDArray[np.float32], purpose: str) -> None:
    labels = np.unique(label)
    if len(labels) < 2:
        outcome = "held" if labels[0] == 1 else "were lost"
        raise InputError(
            f"all {len(label)} grasps to {purpose} {outcome}: there is nothing to learn",
            where="--grasps",
            allowed="held and lost grasps",
            hint="collect more grasps, or of more objects",
        )
