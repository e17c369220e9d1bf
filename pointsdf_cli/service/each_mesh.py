"""Meshes of many clouds, each by itself: one file a cloud, resumable, over several processes."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pointsdf_cli.camera.scene_file import SceneFileOptions
from pointsdf_cli.errors import as_input_error
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.io.atomic import atomic_path, write_text_atomic
from pointsdf_cli.io.each_file import is_done
from pointsdf_cli.io.meshes import UNITS, save_mesh
from pointsdf_cli.io.provenance import file_sha256
from pointsdf_cli.io.strict_json import plain, to_json
from pointsdf_cli.planning.object_view import MeshSettings
from pointsdf_cli.service.identity import PlannerFiles, bundled_digest, weights_digest


@dataclass(frozen=True)
class MeshTask:
    """One cloud for one worker process.

    Attributes:
        cloud: The view.
        files: Its reading options.
        pose: Its camera pose as typed.
        out: Mesh file to write. Beside it, a JSON file of that name records options and outcome.
        settings: The same for all clouds.
        threads: Threads of the process.
        force: Make it again where it is there.
    """

    cloud: Path
    files: SceneFileOptions
    pose: str | None
    out: Path
    settings: MeshSettings
    threads: int = 1
    force: bool = False

    @property
    def record(self) -> Path:
        """Record beside the mesh."""
        return self.out.with_suffix(".json")

    def config(self) -> dict[str, Any]:
        """All settings that determine the mesh, in plain types."""
        settings, weights = self.settings, self.settings.checkpoint
        own = {
            "cloud": self.cloud,
            "cloud_sha256": file_sha256(self.cloud),
            "camera_pose": self.pose,
            "weights": bundled_digest() if weights is None else weights_digest(weights),
            "robot": PlannerFiles(robot=settings.robot).identity()["robot"],
            **self.files.digests(self.pose),
        } | ({} if settings.start is None else {"start": settings.start})
        same = ("segment", "target", "workspace", "cleaned", "device")
        shared = {name: getattr(settings, name) for name in same}
        config: dict[str, Any] = plain(asdict(self.files) | asdict(settings.choices) | shared | own)
        return config


@dataclass(frozen=True)
class MeshSummary:
    """Outcome of one cloud.

    Attributes:
        vertices, faces: Numbers of them.
        seconds: Duration of the computation [s].
        warnings: Sentences about a mesh that lacks many of the seen points.
    """

    vertices: int
    faces: int
    seconds: float
    warnings: tuple[str, ...]


def mesh_cloud(task: MeshTask) -> MeshSummary | None:
    """Mesh one cloud into its file; None if it is there already.

    Raises:
        InputError: The cloud cannot be used, or the network sees nothing solid in it.
        OptionsDifferError: The mesh was made with other options, from another cloud, or is damaged.
    """
    config, settings = task.config(), task.settings
    if not task.force and is_done(task.out, task.record, config):
        return None
    seen = settings.view(task.cloud, task.files, task.pose)
    # Seconds of imports: only for a cloud that can be used.
    from pointsdf_cli.geometry.isosurface import EmptySurfaceError
    from pointsdf_cli.models.registry import use_threads
    from pointsdf_cli.service.resident import loaded

    use_threads(task.threads)
    resident = loaded(PlannerFiles(checkpoint=settings.checkpoint), settings.device)
    with as_input_error(kind=EmptySurfaceError):  # one cloud's fault, not the stage's end
        completed = resident.mesh(seen, settings.choices, str(task.cloud))
    made = completed.mesh
    vertices = apply_transform(seen.T_frame_camera, made.vertices) / UNITS[task.files.unit]
    summary = MeshSummary(len(vertices), len(made.faces), completed.seconds, completed.warnings)
    with atomic_path(task.out) as temporary:
        save_mesh(temporary, vertices, made.faces, seen.comments)
        told = {"config": config, "sha256": file_sha256(temporary), **asdict(summary)}
        # The old mesh must not stand beside the new record; of a symbolic link, its target.
        task.out.resolve().unlink(missing_ok=True)
        write_text_atomic(task.record, to_json(told, indent=1) + "\n")
    return summary
