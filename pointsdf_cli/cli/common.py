"""Options that commands share, and checks of their values."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pointsdf_cli import choices
from pointsdf_cli.cli.reporter import Reporter as Reporter
from pointsdf_cli.errors import InputError

if TYPE_CHECKING:
    from pointsdf_cli.planning.grasp_planner import PlanOptions
    from pointsdf_cli.service.identity import PlannerFiles


def job_count(jobs: int) -> int:
    """The number of processes for `--jobs`.

    Raises:
        InputError: Negative, or absurdly many.
    """
    if not 0 <= jobs <= 1024:
        raise InputError(f"{jobs} jobs", where="--jobs", allowed="0 (all cores) to 1024")
    return jobs or len(os.sched_getaffinity(0))


def check_seed(seed: int) -> int:
    """Check that `seed` can seed a random generator, and return it.

    Raises:
        InputError: Negative or beyond 63 bits.
    """
    if not 0 <= seed < 2**63:
        raise InputError(f"{seed} is not a seed", where="--seed", allowed="0 to 2⁶³ − 1")
    return seed


def check_device(name: str) -> str:
    """Refuse an unknown kind of device, without importing torch.

    Raises:
        InputError: Neither cpu nor cuda nor cuda:N.
    """
    kind, colon, number = name.partition(":")
    numbered = not colon or number.isdecimal()
    if kind not in ("cpu", "cuda") or not numbered:
        raise InputError(f"no device {name!r}", where="--device", allowed="cpu, cuda, cuda:N")
    return name


Seed = Annotated[int, typer.Option(help="Random seed.", callback=check_seed)]
Jobs = Annotated[
    int,
    typer.Option("--jobs", "-j", help="Number of processes; 0 uses all cores.", callback=job_count),
]
EachJobs = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        "-j",
        help="With --each: number of processes; 0 uses all cores.  [default: 0]",
        callback=lambda jobs: None if jobs is None else job_count(jobs),
    ),
]
EachSkipBad = Annotated[
    bool,
    typer.Option(
        "--skip-bad", help="With --each: exit with 0 even if some inputs could not be used."
    ),
]
Threads = Annotated[
    int, typer.Option(min=0, max=1024, help="Number of processor threads; 0 uses the idle ones.")
]


def bundled_robot(robot: Path | None) -> Path | None:
    """The file of a robot that was given by its bundled name; other paths as they are."""
    if robot is None:
        return None
    from pointsdf_cli.assets import robot_file

    return robot_file(robot)


Robot = Annotated[
    Path | None,
    typer.Option(
        help="Robot YAML, panda, ur5e_2f85 or lbr4_barrett.  [default: LBR4 with Allegro hand]",
        callback=bundled_robot,
    ),
]
RobotOfFile = Annotated[
    Path | None,
    typer.Option(
        help="Robot YAML, if it is none of the bundled ones.  [default: by the joints in the file]",
        callback=bundled_robot,
    ),
]
RobotInScene = Annotated[
    Path | None,
    typer.Option(
        help="Robot, to remove its points from a scene: YAML, panda, ur5e_2f85 or lbr4_barrett "
        "[default: LBR4 with Allegro hand].",
        callback=bundled_robot,
    ),
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="Q",
        help="The robot's configuration [rad], or a file; motions begin there [default: its home].",
    ),
]
Device = Annotated[
    str, typer.Option(help="Compute device: cpu, cuda or cuda:N.", callback=check_device)
]
Sensor = Annotated[choices.Sensor, typer.Option(help="Depth camera to simulate.")]
Solver = Annotated[choices.Solver, typer.Option(help="Solver; slsqp is the paper's, and slow.")]
Checkpoint = Annotated[
    Path | None,
    typer.Option(
        help="Reconstruction weights [default: the bundled ones that the success weights name, "
        "else pointsdf_real]."
    ),
]
GraspCheckpoint = Annotated[
    Path | None, typer.Option(help="Success weights [default: the robot's bundled ones].")
]
Precision = Annotated[
    choices.Precision, typer.Option(help="Precision; auto takes bfloat16 where it is faster.")
]
Pattern = Annotated[
    str, typer.Option(help="Only meshes whose names match this pattern, such as '*.ply'.")
]
Shake = Annotated[
    float,
    typer.Option(min=0, max=100, help="Shake the lifted object with this acceleration [m/s²]."),
]
Views = Annotated[Path, typer.Option(help="Folder of views made by `rgrasp render`.")]
Grasps = Annotated[Path, typer.Option(help="Folder of grasps made by `rgrasp collect-grasps`.")]
Cache = Annotated[
    Path | None,
    typer.Option(help="Cache folder of the network's features.  [default: GRASPS-cache]"),
]
Resume = Annotated[bool, typer.Option("--resume", help="Resume from OUT.")]
Unit = Annotated[choices.Unit, typer.Option(help="Unit of the input files.")]
Frame = Annotated[
    choices.Frame | None,
    typer.Option(help="Frame of the cloud [default: as the file says, else camera]."),
]
DropInvalid = Annotated[
    bool, typer.Option("--drop-invalid", help="Leave out points that are NaN or infinite.")
]
Server = Annotated[
    str | None,
    typer.Option(
        metavar="URL",
        help="Plan on a running `rgrasp serve`, such as http://127.0.0.1:8765; its token is read "
        "from RGRASP_TOKEN.",
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress on stderr.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing output.")]
Workspace = Annotated[
    str | None,
    typer.Option(
        metavar="X0,Y0,Z0,X1,Y1,Z1",
        help="With --segment auto: workspace, a box in the world [m] [default: "
        "0.2,-0.9,-0.05,1.6,0.9,0.6].",
    ),
]
Intrinsics = Annotated[
    str | None,
    typer.Option(
        metavar="K.json",
        help="Intrinsics of a depth image: K matrix, ROS camera_info, RealSense or Open3D "
        "intrinsics (JSON or YAML), or kinect2.",
    ),
]
DepthScale = Annotated[
    float | None,
    typer.Option(
        help="Metres per unit of a depth image [default: 0.001 for integers, 1 for floats]."
    ),
]
Mask = Annotated[
    str | None,
    typer.Option(
        metavar="MASK.png",
        help="Mask image of the object, from any segmenter: its nonzero pixels; MASK.png:7 "
        "takes the pixels of value 7.",
    ),
]
CameraPose = Annotated[
    str | None,
    typer.Option(
        metavar="POSE",
        help="Camera pose in the world: X,Y,Z,QW,QX,QY,QZ, or a file. To try things out, "
        "table[:X,Y]: z = 0 is the observed table, the object at 0.6,0 or X,Y.",
    ),
]
NoClean = Annotated[
    bool, typer.Option("--no-clean", help="Keep flying pixels, outliers and specks.")
]
Shard = Annotated[
    str | None,
    typer.Option(metavar="i/n", help="Process only every n-th file, from the i-th (0-based)."),
]
SkipBad = Annotated[
    bool, typer.Option("--skip-bad", help="Exit with 0 even if some inputs could not be used.")
]


def table_files(
    out: Path, beside: tuple[str, ...], inputs: Iterable[Path | None], force: bool
) -> list[Path]:
    """Check that a table and the files beside it can be written; returns their paths.

    Raises:
        InputError: The table's name ends like those beside it, a file exists or is an input, or
            the folder cannot be written.
    """
    from pointsdf_cli.io.apart import require_apart
    from pointsdf_cli.io.atomic import require_folder, require_new

    if not out.name or out.suffix.lower() in beside:
        what = f"{out} is not a file name, or ends like the files written beside the table"
        raise InputError(what, where="--out", allowed="such as table.json")
    files = [out, *(out.with_suffix(suffix) for suffix in beside)]
    require_apart(files, inputs)
    for path in files:
        require_new(path, force)
    require_folder(out.parent)
    return files


def check_suffix(path: Path, option: str, suffixes: tuple[str, ...]) -> None:
    """Refuse an output name by which the file would be read as something else.

    Raises:
        InputError: It has none of the suffixes.
    """
    if path.suffix.lower() not in suffixes:
        ends = " or ".join(suffixes)
        what = f"{path} does not end in {ends}, and other commands would not read it"
        allowed = f"such as {path.stem or 'result'}{suffixes[0]}"
        raise InputError(what, where=option, allowed=allowed)


def take_threads(threads: int) -> None:
    """Compute with so many processor threads; 0 stands for as many as there are idle ones."""
    from pointsdf_cli.io.idle_processors import idle_processors
    from pointsdf_cli.models.registry import use_threads

    use_threads(threads or idle_processors())


def say_if_from_another(
    reporter: Reporter, files: PlannerFiles | PlanOptions, method: str = "reconstruction"
) -> None:
    """Warn if the success network was trained on another reconstruction than it will read.

    Args:
        reporter: Receives the warning.
        files: Robot and networks.
        method: One of `choices.Method`; partial views read no reconstruction.

    Raises:
        InputError: No such checkpoint or robot.
    """
    checkpoint, success = files.checkpoint, files.grasp_checkpoint
    if method != "reconstruction" or (checkpoint is None and success is None):
        return

    from pointsdf_cli.models.checkpoint_kinds import bundled_success
    from pointsdf_cli.models.grasp_checkpoint import (
        other_training_reconstruction,
        reconstruction_to_plan_with,
    )
    from pointsdf_cli.robot.description import load_robot

    success = success or bundled_success(load_robot(files.robot))
    if success is None:  # the robot has no bundled one: planning will ask for it
        return
    read = checkpoint or reconstruction_to_plan_with(success)
    other = other_training_reconstruction(success, read)
    if other is not None:
        reporter.say(
            f"the success network was trained on the reconstruction {other} but reads {read}: its "
            "probabilities may be wrong (train-gs --sdf trains one for it)"
        )


def labels_of(checkpoints: list[Path]) -> list[str]:
    """Short names: each directory's own, or its whole path where two would be the same.

    Raises:
        InputError: A name is given twice.
    """
    whole = [path.resolve() for path in checkpoints]
    if len(set(whole)) < len(whole):
        raise InputError("a checkpoint is given twice", where="--checkpoint", allowed="each once")
    names = [path.name for path in whole]
    return [path.name if names.count(path.name) == 1 else str(path) for path in whole]


def cache_beside(folder: Path) -> Path:
    """Cache folder of what is computed from a folder's grasps: `grasps-cache` beside `grasps`."""
    whole = folder.resolve()
    return whole.with_name(whole.name + "-cache")


def check_picture(path: Path | None, force: bool) -> None:
    """Check, before any work, that a PNG can be written at `path`; None is passed over.

    Raises:
        InputError: It has another suffix, exists already, or its folder cannot be written.
    """
    from pointsdf_cli.io.atomic import require_place

    if path is None:
        return
    if path.suffix.lower() != ".png" or path.is_dir():
        raise InputError("is not a PNG file name", where=path, allowed="a name that ends in .png")
    require_place(path, force)


def torch_device(name: str) -> str:
    """As `processor.usable_device`; torch is imported for other devices than the processor only."""
    if name == "cpu":
        return name

    from pointsdf_cli.models.processor import usable_device

    return usable_device(name)
