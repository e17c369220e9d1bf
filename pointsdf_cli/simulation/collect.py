"""The grasp data set: labelled attempts over a folder of meshes, resumable object by object."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.apart import require_apart
from pointsdf_cli.io.grasps import (
    SCHEMA,
    VERSION,
    Grasps,
    GraspsMeta,
    join_grasps,
    read_grasps,
    write_grasps,
)
from pointsdf_cli.io.hdf5 import OptionsDifferError, is_complete
from pointsdf_cli.io.meshes import load_mesh, named_artifacts
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.robot.description import load_robot, robot_digest
from pointsdf_cli.simulation.attempt import Attempt, AttemptConfig, PreshapeSource, as_grasps
from pointsdf_cli.simulation.attempter import Attempter
from pointsdf_cli.simulation.sim_object import SimObject, prepare_object

TRAIN, TEST = "train", "test"
TEST_SHARE = 0.2
"""Share of the objects that is held out. (The paper holds out 1821 of 9111 grasps.)"""
ATTEMPTS_A_WRITE = 20
"""Number of attempts with one object that a killed run may lose, or a twentieth of them if that is
more: the whole file is written each time."""


@dataclass(frozen=True)
class CollectTask:
    """One object, for one worker process.

    Attributes:
        name: Name of the artifact.
        mesh, out: Files.
        quota: Desired number of executed grasps.
        split: "train" or "test".
        config: Settings that determine outcomes.
        seed: Random seed.
        robot: YAML file of the robot; the bundled one if None.
        patience: Two numbers: the largest number of attempts (executed or not) before the first
            executed grasp, and its increase for each executed grasp.
        force: Replace an existing file.
        source: Planner that proposes preshapes; the paper's heuristic if None.
        unit: Unit of the mesh.
    """

    name: str
    mesh: Path
    out: Path
    quota: int
    split: str
    config: AttemptConfig
    seed: int
    robot: Path | None = None
    patience: tuple[int, int] = (60, 12)
    force: bool = False
    source: PreshapeSource | None = None
    unit: str = "m"

    def goes_on(self, attempts: int, executed: int) -> bool:
        """Whether a further attempt is wanted after some, of which some were executed."""
        most = self.patience[0] + self.patience[1] * executed
        return executed < self.quota and attempts < most


def collect_object(task: CollectTask) -> dict[str, int] | None:
    """Make attempts with one object until its quota is met or its patience ends.

    An existing file is continued. It is written now and then, for the case of a kill. An object
    without a further view counts as exhausted.

    Returns:
        Number of new attempts by cause; None if nothing was left to do.

    Raises:
        InputError: The mesh cannot be used, does not fit the hand, never rests or is never seen.
    """
    torch.set_num_threads(1)
    config = _options_of(task)
    done: Grasps | None = None
    complete, index, executed = False, 0, 0
    if not task.force and is_complete(task.out, schema=SCHEMA, version=VERSION, config=config):
        done, there = read_grasps(task.out)
        complete, index, executed = there.complete, len(done), int(done.executed.sum())
        if complete and not task.goes_on(index, executed):
            return None
    mesh = load_mesh(task.mesh, task.unit)
    item = prepare_object(replace(mesh, name=task.name))
    attempter = _attempter(task.robot, task.config, task.seed, task.source)
    attempter.check(item)
    robot = attempter.robot
    meta = GraspsMeta(
        task.mesh.name,
        mesh.sha256,
        task.split,
        robot.name,
        robot.joint_names,
        robot.preshape_joints,
    )
    causes: Counter[str] = Counter()
    while True:
        most = max(ATTEMPTS_A_WRITE, index // 20)
        attempts = _some_attempts(task, attempter, item, index, executed, most)
        if attempts:
            made = as_grasps(attempts)
            done = made if done is None else join_grasps([done, made])
            index, executed = len(done), int(done.executed.sum())
            causes.update(made.count())
        elif complete or done is None:
            break
        complete = len(attempts) < most
        told = replace(meta, complete=complete)
        write_grasps(task.out, done, told, seed=task.seed, config=config)
        if complete:
            break
    return dict(causes) or None


def _some_attempts(
    task: CollectTask, attempter: Attempter, item: SimObject, index: int, executed: int, most: int
) -> list[Attempt]:
    """The next attempts, `most` of them or fewer where no more are wanted or possible.

    Raises:
        InputError: The first attempt is not possible.
    """
    attempts: list[Attempt] = []
    while len(attempts) < most and task.goes_on(index, executed):
        try:
            attempt = attempter.attempt(item, index)
        except InputError:
            if not index:
                raise
            break
        attempts.append(attempt)
        executed += attempt.label >= 0
        index += 1
    return attempts


def is_of_run(task: CollectTask) -> bool:
    """Whether there are grasps of an object that were made with the same options."""
    try:
        return is_complete(task.out, schema=SCHEMA, version=VERSION, config=_options_of(task))
    except InputError:
        return False


def require_same_options(tasks: Iterable[CollectTask]) -> None:
    """Require the same options in existing files of objects outside this call, which count too.

    Raises:
        OptionsDifferError: A file was made with other options.
    """
    for task in tasks:
        if not task.out.is_file():
            continue
        try:
            is_complete(task.out, schema=SCHEMA, version=VERSION, config=_options_of(task))
        except OptionsDifferError as error:
            raise OptionsDifferError(
                error.what,
                where=error.where,
                hint="choose another --out, or remove it: --count is too small to make it anew",
            ) from error


def _options_of(task: CollectTask) -> dict[str, Any]:
    """All settings that determine the grasps of one object."""
    config = task.config.as_dict() | {"seed": task.seed, "name": task.name}
    config |= {"split": task.split}  # the split depends on the other meshes
    config |= {} if task.source is None else {"preshapes": task.source.as_dict()}
    config |= {} if task.unit == "m" else {"unit": task.unit}
    return config | {"mesh": file_sha256(task.mesh), "robot": robot_digest(task.robot)}


def split_of(names: Sequence[str], seed: int) -> dict[str, str]:
    """Split of each object, "train" or "test": a random fifth of the objects is held out."""
    order = np.random.default_rng([seed, 77]).permutation(len(names))
    held_out = {int(i) for i in order[: round(TEST_SHARE * len(names))]}
    return {name: TEST if i in held_out else TRAIN for i, name in enumerate(sorted(names))}


def make_tasks(
    found: Sequence[Path],
    meshes: Path,
    out: Path,
    count: int,
    config: AttemptConfig,
    seed: int,
    robot: Path | None,
    force: bool,
    source: PreshapeSource | None = None,
    unit: str = "m",
) -> dict[str, CollectTask]:
    """Tasks of all objects by name, with their splits and first quotas.

    Args:
        found: Mesh files.
        meshes, out: Folders of meshes and of artifacts.
        count: Total number of executed grasps.
        config, seed, robot, force, source, unit: As in `CollectTask`.

    Raises:
        InputError: The count is below 1, or an artifact would replace an input.
    """
    paths = named_artifacts(found, meshes, out)
    require_apart((path for _, path in paths.values()), [*found, robot])
    splits = split_of(list(paths), seed)
    quotas = first_quotas(splits, count)
    return {
        name: CollectTask(
            name=name,
            mesh=mesh,
            out=path,
            quota=quotas[name],
            split=splits[name],
            config=config,
            seed=seed,
            robot=robot,
            force=force,
            source=source,
            unit=unit,
        )
        for name, (mesh, path) in paths.items()
    }


def first_quotas(splits: dict[str, str], count: int) -> dict[str, int]:
    """Quotas of executed grasps for all objects; the splits sum to 80% and 20%.

    Raises:
        InputError: The count is below 1.
    """
    if count < 1:
        raise InputError(f"{count} grasps", where="--count", allowed="1 or more")
    by_split = {s: sorted(n for n, t in splits.items() if t == s) for s in (TRAIN, TEST)}
    test = round(count * 1821 / 9111) if by_split[TEST] else 0
    return _spread(by_split[TRAIN], count - test) | _spread(by_split[TEST], test)


def next_quotas(
    quotas: dict[str, int], executed: dict[str, int], splits: dict[str, str], wanted: dict[str, int]
) -> dict[str, int] | None:
    """Quotas that make up for objects that could not fill theirs; None if all are met.

    They depend only on the results of each object, so a resumed run has the same.

    Args:
        quotas: Quotas of the round before.
        executed: Number of executed grasps in each object's file; without refused objects.
        splits: Split of each object.
        wanted: Desired number of executed grasps in each split.
    """
    more: dict[str, int] = {}
    for split, target in wanted.items():
        names = sorted(n for n, s in splits.items() if s == split)
        have = {n: min(executed.get(n, 0), quotas[n]) for n in names}
        missing = target - sum(have.values())
        able = [n for n in names if have[n] >= quotas[n]]
        if missing > 0 and able:
            more |= {n: extra for n, extra in _spread(able, missing).items() if extra}
    if not more:
        return None
    return {name: quota + more.get(name, 0) for name, quota in quotas.items()}


def _spread(names: Sequence[str], count: int) -> dict[str, int]:
    """Distribute `count` over the names as evenly as whole numbers allow."""
    base, rest = divmod(count, max(1, len(names)))
    return {name: base + (i < rest) for i, name in enumerate(names)}


@functools.lru_cache(maxsize=1)
def _attempter(
    robot: Path | None, config: AttemptConfig, seed: int, source: PreshapeSource | None
) -> Attempter:
    """The process's attempter, cached with its networks, kinematics and physics client."""
    propose = None if source is None else source.load()
    return Attempter(load_robot(robot), config, seed, propose=propose)


def wanted_of(splits: dict[str, str], quotas: dict[str, int]) -> dict[str, int]:
    """Number of executed grasps in the first quotas of each split."""
    totals = {TRAIN: 0, TEST: 0}
    for name, quota in quotas.items():
        totals[splits[name]] += quota
    return totals


def missing_of(
    executed: dict[str, int], splits: dict[str, str], wanted: dict[str, int]
) -> dict[str, int]:
    """Number of executed grasps that each split lacks; arguments as in `next_quotas`."""
    have = wanted_of(splits, executed)
    return {split: max(0, target - have[split]) for split, target in wanted.items()}
