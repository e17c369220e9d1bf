"""`rgrasp mesh --each`: every cloud by itself, into one folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from pointsdf_cli.cli import common

if TYPE_CHECKING:
    from pointsdf_cli.camera.scene_file import SceneFileOptions
    from pointsdf_cli.service.each_mesh import MeshSettings


def mesh_each(
    reporter: common.Reporter,
    clouds: Sequence[Path],
    pose: str | None,
    files: SceneFileOptions,
    settings: MeshSettings,
    inputs: Sequence[Path | str | None],
    *,
    out: Path,
    form: str,
    jobs: int | None,
    threads: int,
    force: bool,
    skip_bad: bool,
) -> None:
    """Mesh every cloud into `out`, keeping what is there.

    Args:
        reporter: Receives progress and results.
        clouds: One view of each object.
        pose: Camera pose as typed, the same for all; None for none.
        files: Reading options of each view.
        settings: The same for all clouds.
        inputs: Everything that is read, which no output may replace.
        out: Folder of the meshes.
        form: Their format.
        jobs: Processes; None for all cores.
        threads: Threads of each process; 0 takes one.
        force, skip_bad: The command's options of these names.

    Raises:
        InputError: Clouds that cannot be used; the others are done.
    """
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_folder
    from pointsdf_cli.io.each_file import require_one_name_each
    from pointsdf_cli.service.each_mesh import MeshTask, mesh_cloud

    require_one_name_each(clouds)
    out = require_folder(out)
    tasks = []
    for cloud in clouds:
        path = out / f"{cloud.stem}.{form}"
        task = MeshTask(cloud, files, pose, path, settings, threads or 1, force)
        tasks.append((cloud.stem, task))
    require_apart((p for _, task in tasks for p in (task.out, task.record)), inputs)
    report = reporter.stage("mesh", tasks, mesh_cloud, jobs or common.job_count(0), [out])
    meshes = {name: asdict(summary) for name, summary in report.made.items()}
    lines = [
        f"{out / name}.{form}: {made.vertices} vertices, {made.faces} faces, {made.seconds:.2f} s"
        for name, made in report.made.items()
    ]
    reporter.finish(report, out, skip_bad, {"meshes": meshes}, lines)
