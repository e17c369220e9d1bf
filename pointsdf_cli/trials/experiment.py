"""One experiment of `rgrasp trial`: its tasks, and its results in files and for the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.apart import require_apart
from pointsdf_cli.io.atomic import require_folder, write_text_atomic
from pointsdf_cli.io.batch import StageReport
from pointsdf_cli.io.trials import TrialRow, read_trial, write_trials
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.trials.pictures import caption, trial_strip
from pointsdf_cli.trials.planner_variants import check_variant
from pointsdf_cli.trials.protocol import Trial
from pointsdf_cli.trials.report import html_report, markdown_report, percent
from pointsdf_cli.trials.run import TrialConfig, TrialTask, read_rows, require_same_options
from pointsdf_cli.trials.scenes import object_mesh
from pointsdf_cli.trials.summary import Summary, summarise
from pointsdf_cli.viz.grasp_report import png_bytes
from pointsdf_cli.viz.robot_picture import RobotMeshes


def make_tasks(
    trials: Sequence[Trial], config: TrialConfig, out: Path, films: int, force: bool
) -> dict[str, TrialTask]:
    """Tasks by name, with their files below `out`; `films` of them, evenly spaced, are filmed.

    Raises:
        InputError: A planner cannot be made, a file would replace an input, or `out` cannot be
            written.
    """
    for variant in dict.fromkeys(trial.variant for trial in trials):
        check_variant(variant, config.planning)
    folder = require_folder(require_folder(out) / "trials")
    filmed = {round(i * len(trials) / films) for i in range(films)}
    tasks = {
        one.name: TrialTask(
            one,
            folder / f"{one.name}.h5",
            config,
            out / "films" / f"{one.name}.gif" if i in filmed else None,
            force,
        )
        for i, one in enumerate(trials)
    }
    used = config.planning
    require_apart(
        [*(task.out for task in tasks.values()), out / "trials.h5"],
        [*{t.object.mesh for t in trials}, used.checkpoint, used.grasp_checkpoint, used.robot],
    )
    return tasks


def write_results(
    out: Path, tasks: Mapping[str, TrialTask], ran: StageReport[TrialRow], pictures: int
) -> tuple[dict[str, Any], list[str]]:
    """Write trials.h5, report.html and report.md into `out`, if there is any result.

    Args:
        out: The experiment's folder.
        tasks: All trials, by name.
        ran: Outcome of those that ran now.
        pictures: Largest number of failures to draw.

    Returns:
        Number of results, refused trials with their reasons, shares by planner variant; and a
        line of text for each variant.

    Raises:
        OptionsDifferError: The file of a trial that did not run now was made with other options.
    """
    refused = dict(ran.refused)
    now = {*ran.made, *ran.kept, *refused}
    require_same_options([task for name, task in tasks.items() if name not in now])
    # Ignore files of earlier runs for objects that are refused now.
    tried = [task for name, task in tasks.items() if name not in refused]
    rows = read_rows(tried)
    reasons = _reasons(tasks, refused)
    found: dict[str, Any] = {"trials": len(rows), "refused": reasons}
    if not rows:
        return found, []
    others = {*(out / "trials").glob("*.h5")} - {task.out for task in tasks.values()}
    left = f"{len(others)} trials of other options in {out / 'trials'} are not in the tables"
    seed, config = tried[0].trial.seed, tried[0].config.as_dict()
    write_trials(out / "trials.h5", rows, seed=seed, config=config)
    title = f"rgrasp trials: {out.resolve().name}"
    strips = _failures(tried, pictures)
    write_text_atomic(out / "report.html", html_report(rows, strips, title, reasons))
    write_text_atomic(out / "report.md", markdown_report(rows, title, reasons) + "\n")
    summaries = summarise(rows)
    found |= {
        "lifted": {s.name: s.lifted.value for s in summaries},
        "held": {s.name: s.held.value for s in summaries},
        "unshaken": {s.name: s.unshaken.value for s in summaries if s.unshaken.trials},
        "succeeded": {s.name: s.succeeded.value for s in summaries},
        "no_plan": {s.name: s.no_plan.value for s in summaries},
        "contact": {s.name: s.contact.value for s in summaries},
    }
    return found, [_line(summary) for summary in summaries] + [left] * bool(others)


def _reasons(tasks: Mapping[str, TrialTask], refused: Mapping[str, InputError]) -> dict[str, str]:
    """Reasons of refused trials, by object; with their number, unless all of it are refused."""
    objects = Counter(task.trial.object.name for task in tasks.values())
    told: dict[str, Counter[str]] = {}
    for name, error in refused.items():
        told.setdefault(tasks[name].trial.object.name, Counter())[str(error)] += 1
    reasons = {}
    for item, counts in told.items():
        refusals, trials = counts.total(), objects[item]
        part = "" if refusals == trials else f", {refusals} of {trials} trials"
        each = [why if len(counts) == 1 else f"{why} ({count})" for why, count in counts.items()]
        reasons[f"{item}{part}"] = "; ".join(each)
    return reasons


def _line(summary: Summary) -> str:
    return (
        f"{summary.name}: lifted {percent(summary.lifted)}, held {percent(summary.held)}, "
        f"unshaken {percent(summary.unshaken)}, no plan {percent(summary.no_plan)}"
    )


def _failures(tasks: Sequence[TrialTask], most: int) -> list[tuple[str, bytes]]:
    """Captions and pictures of trials that failed, those of the whole method first."""
    failed = []
    for task in tasks:
        if task.out.is_file():
            row, evidence = read_trial(task.out)
            if not row.succeeded or row.unshaken == 0:
                failed.append((_importance(row), task, row, evidence))
    failed.sort(key=lambda one: one[0])
    robot = None
    strips = []
    for _, task, row, evidence in failed[:most]:
        robot = robot or RobotMeshes(load_robot(task.config.planning.robot), sections=20)
        mesh, *others = (object_mesh(o) for o in (task.trial.object, *task.trial.others))
        strip = trial_strip(robot, mesh, evidence, others)
        strips.append((caption(row), png_bytes(strip)))
    return strips


def _importance(row: TrialRow) -> tuple[bool, bool, bool, str]:
    return bool(row.ablation), row.method != "reconstruction", row.held, row.object
