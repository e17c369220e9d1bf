"""Conversion of answers to trees of plain values and arrays, and back."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from pointsdf_cli.errors import InputError, RgraspError
from pointsdf_cli.io.plans import AcceptedGrasps, Plan, RejectedSeeds
from pointsdf_cli.planning.environment import Obstacle
from pointsdf_cli.planning.plan_request import PlanResult


def result_tree(result: PlanResult) -> dict[str, Any]:
    """The whole answer."""
    plan = replace(result.plan, timings=dict(result.plan.timings))
    obstacles = [obstacle_tree(each) for each in result.obstacles]
    return asdict(replace(result, plan=plan, obstacles=())) | {"obstacles": obstacles}


def obstacle_tree(obstacle: Obstacle) -> dict[str, Any]:
    """An obstacle, without what was prepared from its mesh."""
    tree = asdict(replace(obstacle, prepared=None))
    del tree["prepared"]
    return tree


def result_of(tree: Any) -> PlanResult:
    """The answer of `result_tree`.

    Raises:
        RgraspError: It is none.
    """
    try:
        plan = dict(tree["plan"])
        rejected, accepted = dict(plan["rejected"]), dict(plan["accepted"])
        rejected["reasons"] = tuple(rejected["reasons"])
        accepted["kinds"] = tuple(accepted["kinds"])
        plan |= {name: tuple(plan[name]) for name in ("joint_names", "link_names")}
        plan |= {"rejected": RejectedSeeds(**rejected), "accepted": AcceptedGrasps(**accepted)}
        around = [each | {"size": tuple(each["size"])} for each in tree["obstacles"]]
        obstacles = tuple(Obstacle(**each) for each in around)
        return PlanResult(
            Plan(**plan),
            tuple(map(str, tree["report"])),
            tuple(map(str, tree["warnings"])),
            np.asarray(tree["start"], dtype=np.float64),
            np.asarray(tree["points"], dtype=np.float64),
            np.asarray(tree["camera"], dtype=np.float64),
            obstacles,
            dict(tree["options"]),
            float(tree["least"]),
            bool(tree["table"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError, InputError) as error:
        raise RgraspError(f"the server's answer is not a plan ({error})") from error
