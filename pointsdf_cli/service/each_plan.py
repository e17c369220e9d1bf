"""Plans of many scenes, each by itself: one file a scene, resumable, over several processes."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pointsdf_cli.camera.scene_file import SceneFileOptions
from pointsdf_cli.errors import as_input_error
from pointsdf_cli.io.atomic import require_new
from pointsdf_cli.io.hdf5 import is_complete
from pointsdf_cli.io.plans import SCHEMA, VERSION, read_plan, write_plan
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.io.strict_json import plain
from pointsdf_cli.planning.object_choice import NoObjectError
from pointsdf_cli.service.identity import bundled_digest
from pointsdf_cli.service.plan_settings import PlanSettings, draw_plan


@dataclass(frozen=True)
class PlanTask:
    """One scene for one worker process.

    Attributes:
        cloud: The view.
        files: Its reading options.
        pose: Its camera pose as typed.
        out: Plan file to write.
        picture: Picture to draw; None for none.
        settings: The same for all scenes.
        threads: Threads of the process.
        force: Plan again where the file is there.
    """

    cloud: Path
    files: SceneFileOptions
    pose: str | None
    out: Path
    picture: Path | None
    settings: PlanSettings
    threads: int = 1
    force: bool = False

    def config(self) -> dict[str, Any]:
        """All settings that determine the plan, in plain types."""
        asked = self.settings
        request = asked.request
        around = json.dumps(plain(asdict(request.environment)))
        own = {
            "clouds": [self.cloud],
            "cloud_sha256": [file_sha256(self.cloud)],
            "camera_pose": self.pose,
            "start": request.start,
            "target": asked.target,
            "device": asked.device,
            "environment_sha256": hashlib.sha256(around.encode()).hexdigest(),
            "planner": asked.files.identity(),
            "bundled_weights": bundled_digest(),
            **self.files.digests(self.pose),
        }
        same = ("seed", "segment", "others", "obstacles", "workspace", "cleaned")
        shared = {name: getattr(request, name) for name in same}
        config: dict[str, Any] = plain(asdict(self.files) | asdict(request.choices) | shared | own)
        return config


@dataclass(frozen=True)
class PlanSummary:
    """Outcome of one scene.

    Attributes:
        status, reason, sentence, kind, success_probability: As in `Plan`.
        seconds: Duration of configuration and motion [s].
    """

    status: str
    reason: str
    sentence: str
    kind: str
    success_probability: float
    seconds: float


def plan_scene(task: PlanTask) -> PlanSummary | None:
    """Plan one scene into its file; None if the file is there already, with its picture.

    Raises:
        InputError: The scene cannot be planned from, or the picture's name is taken.
        OptionsDifferError: The file was made with other options, or from another cloud.
    """
    config, drawn = task.config(), task.picture is None or task.picture.is_file()
    there = not task.force and is_complete(task.out, schema=SCHEMA, version=VERSION, config=config)
    if there and drawn:
        return None
    if task.picture is not None and not (task.force or task.out.exists()):
        require_new(task.picture, force=False)  # it is not of an earlier plan
    settings = task.settings
    with as_input_error(kind=NoObjectError):  # one scene's mistake, not the stage's end
        poses = [] if task.pose is None else [task.pose]
        request, _ = settings.read([task.cloud], poses, [task.files])
    # Seconds of imports: only for clouds and options that can be used.
    from pointsdf_cli.models.registry import use_threads
    from pointsdf_cli.service.resident import loaded

    use_threads(task.threads)
    result = loaded(settings.files, settings.device).plan(request)
    if task.picture is not None:
        task.picture.resolve().unlink(missing_ok=True)  # of another plan
    write_plan(task.out, result.plan, seed=request.seed, config=config)
    if task.picture is not None:
        draw_plan(task.picture, result, settings.files.robot)
    return summary_of(task.out)


def summary_of(path: Path) -> PlanSummary:
    """Outcome that a plan file states.

    Raises:
        InputError: It is not a plan file.
    """
    plan = read_plan(path)
    seconds = sum(plan.timings.get(stage, 0.0) for stage in ("configuration", "motion"))
    return PlanSummary(
        plan.status, plan.reason, plan.sentence, plan.kind, plan.success_probability, seconds
    )
