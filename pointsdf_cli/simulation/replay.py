"""Replay of stored attempts, to draw them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pointsdf_cli.choices import GRASP_KINDS
from pointsdf_cli.errors import RgraspError
from pointsdf_cli.io.grasps import CAUSES, HELD, LOST, Grasps, GraspsMeta
from pointsdf_cli.io.meshes import load_mesh
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.attempter import Attempter
from pointsdf_cli.simulation.collect import CollectTask
from pointsdf_cli.simulation.film import Recorder
from pointsdf_cli.simulation.sim_object import prepare_object
from pointsdf_cli.viz.grasp_report import Film

SHOWN = ("close", "grip", "lift", "settle")


def pick_attempts(
    items: Sequence[tuple[str, Grasps, GraspsMeta]], count: int
) -> list[tuple[str, int]]:
    """Pick `count` successes and `count` failures, alternating, of different objects if
    possible."""
    picked: dict[int, list[tuple[str, int]]] = {HELD: [], LOST: []}
    rng = np.random.default_rng(0)
    order = rng.permutation(len(items))
    for _ in range(count):  # a second of an object only if there are too few objects
        for k in order:
            name, grasps, _ = items[int(k)]
            for label, chosen in picked.items():
                rows = [int(r) for r in np.flatnonzero(grasps.simulated & (grasps.label == label))]
                rows = [r for r in rows if (name, r) not in chosen]
                if rows and len(chosen) < count:
                    chosen.append((name, rows[int(rng.integers(len(rows)))]))
    both = [pair for pairs in zip(*picked.values(), strict=False) for pair in pairs]
    return both + [pair for chosen in picked.values() for pair in chosen if pair not in both]


def film_of(task: CollectTask, grasps: Grasps, row: int) -> tuple[Film, Film]:
    """Replay a stored attempt: a strip of its phases, and a film of 20 moments a second.

    Raises:
        RgraspError: It ends differently from the stored one: the simulator has changed.
    """
    mesh = replace(load_mesh(task.mesh, task.unit), name=task.name)
    item = prepare_object(mesh)
    attempter = Attempter(load_robot(task.robot), task.config, task.seed)
    recorder = Recorder()
    try:
        outcome = attempter.replay(item, grasps, row, recorder, task.source is not None)
    finally:
        attempter.close()
    cause = CAUSES[grasps.cause[row]]
    if outcome.cause != cause:
        what = f"attempt {row} ends as {outcome.cause} and is stored as {cause}"
        made = "it was made with another version of rgrasp or PyBullet"
        raise RgraspError(what, where=task.out, hint=f"{made}; collect it again with --force")
    rise = f"rose {100 * outcome.lift_height:.1f} cm"
    title = f"{task.name}, {GRASP_KINDS[grasps.kind[row]]}: {cause}, {rise}"
    start = (grasps.q[row], grasps.T_world_object[row])
    moving = [(moment.phase, (moment.q, moment.T_world_object)) for moment in recorder.moments]
    last = dict(moving)
    strip = [last[phase] for phase in SHOWN if phase in last]  # the lift may end without settling
    frames = [frame for _, frame in moving]
    return Film(title, mesh, [start, *strip]), Film(title, mesh, [start, *frames])
