"""`rgrasp plan --each`: every scene by itself, into one folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from pointsdf_cli.cli import common
from pointsdf_cli.errors import NoPlanError, UnlikelyPlanError

if TYPE_CHECKING:
    from pointsdf_cli.camera.scene_file import SceneFileOptions
    from pointsdf_cli.service.each_plan import PlanSummary
    from pointsdf_cli.service.plan_settings import PlanSettings


def plan_each(
    reporter: common.Reporter,
    clouds: Sequence[Path],
    poses: Sequence[str],
    files: Sequence[SceneFileOptions],
    settings: PlanSettings,
    inputs: Sequence[Path | str | None],
    *,
    out: Path,
    pictures: bool,
    jobs: int | None,
    threads: int,
    force: bool,
    skip_bad: bool,
    accept_unlikely: bool,
) -> None:
    """Plan every scene into `out`, keeping what is there.

    Args:
        reporter: Receives progress and results.
        clouds: One view of each scene.
        poses: Camera poses as typed: none, one for all, or one each.
        files: Reading options of each view.
        settings: The same for all scenes.
        inputs: Everything that is read, which no output may replace.
        out: Folder of the plans.
        pictures: Draw a picture beside each.
        jobs: Processes; None for all cores.
        threads: Threads of each process; 0 takes one.
        force, skip_bad, accept_unlikely: The command's options of these names.

    Raises:
        InputError: Inputs that cannot be used; the others are done.
        NoPlanError: A scene has no plan.
        UnlikelyPlanError: All have one, but at least one is not likely to hold.
    """
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_folder
    from pointsdf_cli.io.each_file import one_for_each, require_one_name_each
    from pointsdf_cli.service.each_plan import PlanTask, plan_scene, summary_of

    require_one_name_each(clouds)
    typed = one_for_each(poses, len(clouds), "--camera-pose")
    out = require_folder(out)
    tasks = []
    for cloud, pose, file in zip(clouds, typed, files, strict=True):
        path = out / f"{cloud.stem}.h5"
        picture = path.with_suffix(".png") if pictures else None
        task = PlanTask(cloud, file, pose, path, picture, settings, threads or 1, force)
        tasks.append((cloud.stem, task))
    require_apart((p for _, task in tasks for p in (task.out, task.picture)), inputs)
    report = reporter.stage("plan", tasks, plan_scene, jobs or common.job_count(0), [out])
    done = [(name, task) for name, task in tasks if name in report.made or name in report.kept]
    found = {name: summary_of(task.out) for name, task in done}
    plans = {name: asdict(summary) for name, summary in found.items()}
    lines = [f"{out / name}.h5: {_told(summary)}" for name, summary in found.items()]
    reporter.finish(report, out, skip_bad, {"plans": plans}, lines)
    least = settings.request.choices.acceptance().least
    _require_plans(found, out, 0.0 if accept_unlikely else least, skip_bad)


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
    unlikely = [
        name
        for name, summary in found.items()
        if not summary.reason and summary.success_probability < least
    ]
    if unlikely:
        raise UnlikelyPlanError(
            f"{len(unlikely)} of {len(found)} plans are not likely to hold: {_names(unlikely)}",
            where=out,
            hint="--accept-unlikely exits with 0 all the same",
        )


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - 5} more" if len(names) > 5 else ""
    return ", ".join(names[:5]) + more
