"""Summary of an experiment: shares by variant, camera and object, tests, causes, times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pointsdf_cli.io.trials import TrialRow
from pointsdf_cli.simulation.verdict import UNTRIED
from pointsdf_cli.trials.statistics import Paired, Share, mcnemar, sign_flips, wilson


@dataclass(frozen=True)
class Summary:
    """One variant's results.

    Attributes:
        name: "method" or "method/ablation".
        method, ablation: Its parts.
        lifted, held, unshaken: Shares of trials with each verdict; `unshaken` of the trials with
            pushes.
        succeeded: Share of trials that held and disturbed no other object.
        by_camera, by_object: `succeeded` by camera and object.
        lost_in: Count of each step in which an object was lost.
        no_plan: Share of trials without a plan.
        contact: Share of trials with a plan in which the robot touched the object early.
        reasons: Count of each reason for no plan.
        causes: Count of each cause that ended an executed trial.
        seconds, cpu_seconds: Median planning time, wall and processor.
        penetration: Largest and mean penetration of the true mesh by planned grasps [m].
        penetrated: Share of planned grasps that enter the true mesh.
    """

    name: str
    method: str
    ablation: str
    lifted: Share
    held: Share
    unshaken: Share
    succeeded: Share
    by_camera: dict[str, Share]
    by_object: dict[str, Share]
    lost_in: dict[str, int]
    no_plan: Share
    contact: Share
    reasons: dict[str, int]
    causes: dict[str, int]
    seconds: float
    cpu_seconds: float
    penetration: tuple[float, float]
    penetrated: Share


def variant_of(row: TrialRow) -> str:
    """Name of a row's planner variant."""
    return f"{row.method}/{row.ablation}" if row.ablation else row.method


def summarise(rows: Sequence[TrialRow]) -> list[Summary]:
    """A summary for each variant, in order of appearance."""
    return [
        _summary(name, [row for row in rows if variant_of(row) == name])
        for name in dict.fromkeys(variant_of(row) for row in rows)
    ]


class Comparison(NamedTuple):
    """Comparison of two variants on their common trials.

    Attributes:
        paired: Test with independent trials.
        by_object: p-value by objects (`sign_flips`), valid for other objects of the same kind.
        objects: Number of objects, and of those on which the variants differ.
    """

    paired: Paired
    by_object: float
    objects: tuple[int, int]


def compare(rows: Sequence[TrialRow], first: str, second: str) -> Comparison:
    """Compare two variants on their common trials."""

    def key(row: TrialRow) -> tuple[object, ...]:
        return row.object, row.yaw_index, row.repeat, row.camera, row.seed

    outcomes = {
        name: {key(row): row.succeeded for row in rows if variant_of(row) == name}
        for name in (first, second)
    }
    shared = [k for k in outcomes[first] if k in outcomes[second]]
    one, other = ([outcomes[name][k] for k in shared] for name in (first, second))
    lead: Counter[object] = Counter()
    for k, a, b in zip(shared, one, other, strict=True):
        lead[k[0]] += int(a) - int(b)
    differing = sum(value != 0 for value in lead.values())
    return Comparison(mcnemar(one, other), sign_flips(list(lead.values())), (len(lead), differing))


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else float("nan")


def _summary(name: str, rows: list[TrialRow]) -> Summary:
    planned = [row for row in rows if row.status == "ok"]
    pushed = [row for row in rows if row.unshaken != UNTRIED]
    searched = [row for row in rows if row.reason != "no_object"]
    depths = np.array([row.penetration for row in planned] or [0.0])

    def succeeded(chosen: list[TrialRow]) -> Share:
        return wilson(sum(row.succeeded for row in chosen), len(chosen))

    def succeeded_by(key: Callable[[TrialRow], str]) -> dict[str, Share]:
        groups = dict.fromkeys(map(key, rows))
        return {group: succeeded([row for row in rows if key(row) == group]) for group in groups}

    return Summary(
        name=name,
        method=rows[0].method,
        ablation=rows[0].ablation,
        lifted=wilson(sum(row.lifted for row in rows), len(rows)),
        held=wilson(sum(row.held for row in rows), len(rows)),
        unshaken=wilson(sum(row.unshaken == 1 for row in pushed), len(pushed)),
        succeeded=succeeded(rows),
        by_camera=succeeded_by(lambda row: row.camera),
        by_object=succeeded_by(lambda row: row.object),
        lost_in=dict(Counter(row.lost_in for row in rows if row.lost_in).most_common()),
        no_plan=wilson(len(rows) - len(planned), len(rows)),
        contact=wilson(sum(row.contact for row in planned), len(planned)),
        reasons=dict(Counter(row.reason for row in rows if row.reason).most_common()),
        causes=dict(Counter(row.cause for row in planned).most_common()),
        seconds=_median([row.planning_time for row in searched]),
        cpu_seconds=_median([row.planning_cpu for row in searched]),
        penetration=(float(depths.max()), float(depths.mean())),
        penetrated=wilson(int((depths > 0).sum()), len(planned)),
    )
