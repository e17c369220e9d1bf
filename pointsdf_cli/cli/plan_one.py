"""`rgrasp plan` of one scene: outputs, report, exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pointsdf_cli.cli import common
from pointsdf_cli.errors import InputError, NoPlanError, UnlikelyPlanError

if TYPE_CHECKING:
    from pointsdf_cli.io.idle_processors import IdleProcessors
    from pointsdf_cli.planning.plan_request import PlanRequest, PlanResult
    from pointsdf_cli.service.plan_settings import PlanSettings


@dataclass(frozen=True)
class PlanOutputs:
    """Files to write.

    Attributes:
        out: The plan.
        picture, trajectory: The picture and the motion; None for none.
    """

    out: Path
    picture: Path | None
    trajectory: Path | None

    def require_free(self, inputs: Sequence[Path | str | None], force: bool) -> None:
        """Refuse files that cannot be written, before the planning. A plan that failed may be
        replaced, with its picture.

        Raises:
            InputError: A wrong suffix, an input, an existing file, two of one path, or a folder
                that cannot be written.
        """
        from pointsdf_cli.io.apart import require_apart
        from pointsdf_cli.io.atomic import require_place

        require_apart([self.out, self.picture, self.trajectory], inputs)
        files = {"--out": self.out, "--picture": self.picture, "--trajectory": self.trajectory}
        asked = {option: path for option, path in files.items() if path is not None}
        if len({os.path.realpath(path) for path in asked.values()}) < len(asked):
            where = ", ".join(f"{option} {path}" for option, path in asked.items())
            raise InputError("two outputs have one path", where=where, allowed="one each")
        common.check_picture(self.picture, force=True)  # its suffix
        # Other files may belong to another plan.
        its_own = {self.out, self.out.with_suffix(".png")} if _is_failed_plan(self.out) else set()
        for path in asked.values():
            require_place(path, force or path in its_own)
        if self.trajectory is not None:
            common.check_suffix(self.trajectory, "--trajectory", (".json",))


def plan_one(
    reporter: common.Reporter,
    request: PlanRequest,
    settings: PlanSettings,
    outputs: PlanOutputs,
    asked: Mapping[str, Any],
    idle: IdleProcessors,
    *,
    server: str | None = None,
    threads: int = 0,
    accept_unlikely: bool = False,
) -> None:
    """Plan, write, report.

    Args:
        reporter: Receives progress and results.
        request: Checked request.
        settings: Settings that the request was made with.
        outputs: Output files that do not exist yet.
        asked: Options as typed, for the plan's provenance.
        idle: Chooses the number of threads if `threads` is 0.
        server: Address of a running `rgrasp serve` to plan on instead.
        threads: Number of threads.
        accept_unlikely: Do not fail on a grasp that is not likely to hold.

    Raises:
        NoPlanError: No plan was found; the file says why.
        UnlikelyPlanError: The plan was written but is not likely to hold.
    """
    from pointsdf_cli.io.motion_file import write_trajectory
    from pointsdf_cli.io.plans import OK, write_plan
    from pointsdf_cli.io.provenance import file_sha256

    files = settings.files
    if server is None:
        # Seconds of imports: only for clouds and options that can be used.
        from pointsdf_cli.models.registry import use_threads
        from pointsdf_cli.service.resident import Resident

        resident = Resident(files, common.torch_device(settings.device))
        use_threads(threads or idle.count())
        resident.planner(request.choices)  # what cannot be loaded is told first
        common.say_if_from_another(reporter, files, request.choices.method)
        result = resident.plan(request, lambda sentence: reporter.say(f"warning: {sentence}"))
        del resident  # the picture needs memory, too
    else:
        from pointsdf_cli.service.client import plan_at

        common.say_if_from_another(reporter, files, request.choices.method)
        result = plan_at(server, request, files)
        reporter.say(*(f"warning: {sentence}" for sentence in result.warnings))
    reporter.say(*result.report)
    out, picture, trajectory = outputs.out, outputs.picture, outputs.trajectory
    answer = result.plan
    for stale in (trajectory, picture):  # a motion to another object must not outlive its plan
        if stale is not None:
            stale.resolve().unlink(missing_ok=True)  # of a symbolic link, its target
    sums = [file_sha256(path) for path in request.names]
    scene = {"clouds": list(request.names), "cloud_sha256": sums, "seed": request.seed}
    config = {**result.options, **scene, **asked}
    write_plan(out, answer, seed=request.seed, config=config)
    found = answer.status == OK
    if trajectory is not None and found:
        write_trajectory(trajectory, answer)
        if asked.get("start") is None:
            begins = "begins at the robot's home; if the robot stands elsewhere, add --start"
            reporter.say(f"{trajectory} {begins}")
    stale_picture = out.with_suffix(".png")
    if picture is None and stale_picture.exists():
        reporter.say(f"{stale_picture} was there before and does not show this plan")
    _report(reporter, result, out, picture, trajectory if found else None)
    if picture is not None:
        sys.stdout.flush()  # the plan is on disk: who reads this need not wait for the picture
        from pointsdf_cli.service.plan_settings import draw_plan

        draw_plan(picture, result, files.robot)
    if not found:
        raise NoPlanError(f"no plan ({answer.reason}): {answer.sentence.rstrip('.')}", where=out)
    least = result.least
    if answer.success_probability < least and not accept_unlikely:
        raise UnlikelyPlanError(
            f"the plan is not likely to hold: probability {answer.success_probability:.2f}, below "
            f"{least:g}",
            where=out,
            hint="--accept-unlikely takes it all the same (exit code 0); or turn the object, or "
            "look at it from another side",
        )


def _is_failed_plan(path: Path) -> bool:
    """Whether a file is a plan that found no grasp; False for anything else."""
    from pointsdf_cli.io.plans import NO_PLAN, read_plan

    try:
        return path.is_file() and read_plan(path).status == NO_PLAN
    except InputError:
        return False


def _report(
    reporter: common.Reporter,
    result: PlanResult,
    out: Path,
    picture: Path | None,
    trajectory: Path | None,
) -> None:
    from pointsdf_cli.io.plans import plan_as_json
    from pointsdf_cli.planning.plan_request import as_sentences, headline

    plan, warnings = result.plan, result.warnings
    files = {"out": out, "picture": picture, "trajectory_file": trajectory}
    lines = []  # empty without a plan: the error message states the reason
    if not plan.reason:
        lines.append(f"{out}: {headline(plan)}")
        # Do not repeat warnings that were printed before the planning.
        doubt = plan.sentence.replace(as_sentences(warnings), "").strip()
        if doubt:
            reporter.say(f"warning: {doubt}")
        if plan.success_probability < 0.5:
            reporter.say("warning: this grasp is more likely to fail than to hold")
        near = float(plan.link_clearance_object.min()) * 1000
        accepted = len(plan.accepted.kinds) + plan.rejected.reasons.count("not_tried")
        lines.append(
            f"planned in {plan.timings['configuration'] + plan.timings['motion']:.2f} s, "
            f"{accepted} grasps accepted; motion of {len(plan.times)} points, "
            f"{plan.times[-1]:.1f} s long; the open hand {near:.1f} mm from the object"
        )
    written = {"the picture": picture, "the motion": trajectory}
    lines += [f"{path}: {what}" for what, path in written.items() if path]
    reporter.result({**plan_as_json(plan), **result.messages(), **files}, lines)
