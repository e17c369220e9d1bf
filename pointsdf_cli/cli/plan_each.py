"""`rgrasp plan --each`: every scene by itself, into one folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from pointsdf_cli.cli import common
from pointsdf_cli.errors import NoPlanError, UnlikelyPlanError

if TYPE_CHECKING:
    from pointsdf_cli.service.each_plan import PlanSummary, PlanTask


def plan_each(
    reporter: common.Reporter,
    tasks: list[tuple[str, PlanTask]],
    out: Path,
    least: float,
    jobs: int | None,
    skip_bad: bool,
) -> None:
    """Plan every scene into `out`, keeping what is there.

    Args:
        reporter: Receives progress and results.
        tasks: The scenes by name.
        out: Folder of the plans.
        least: Probability below which a plan is not likely to hold.
        jobs: Processes; None for all cores.
        skip_bad: The command's option of this name.

    Raises:
        InputError: Inputs that cannot be used; the others are done.
        NoPlanError: A scene has no plan.
        UnlikelyPlanError: All have one, but at least one is not likely to hold.
    """
    from pointsdf_cli.service.each_plan import plan_scene, summary_of

    report = reporter.stage("plan", tasks, plan_scene, jobs or common.job_count(0), [out])
    done = [(name, task) for name, task in tasks if name in report.made or name in report.kept]
    found = {name: summary_of(task.out) for name, task in done}
    plans = {name: asdict(summary) for name, summary in found.items()}
    lines = [f"{out / name}.h5: {_told(summary)}" for name, summary in found.items()]
    reporter.finish(report, out, skip_bad, {"plans": plans}, lines)
    _require_plans(found, out, least, skip_bad)


def _told(summary: PlanSummary) -> str:
    if summary.reason:
        return f"no plan: {summary.reason}"
    return (
        f"{summary.kind} grasp, predicted to hold with probability "
        f"{summary.success_probability:.2f}, {summary.seconds:.2f} s"
    )


def _require_plans(found: dict[str, PlanSummary], out: Path, least: float, skip_bad: bool) -> None:
    """Raise the error of the worst outcome, which sets the exit code."""
    without = [name for name, summary in found.items() if summary.reason]
    if without and not skip_bad:
        raise NoPlanError(
            f"{len(without)} of {len(found)} scenes have no plan: {_names(without)}",
            where=out,
            hint="each file holds its reason; --skip-bad exits with 0 all the same",
        )
    planned = {name: summary for name, summary in found.items() if not summary.reason}
    unlikely = [name for name, each in planned.items() if each.success_probability < least]
    if unlikely:
        raise UnlikelyPlanError(
            f"{len(unlikely)} of {len(found)} plans are not likely to hold: {_names(unlikely)}",
            where=out,
            hint="--accept-unlikely exits with 0 all the same",
        )


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return ", ".join(names[:5]) + more
