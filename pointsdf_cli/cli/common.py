"""Options that every command shares, and the one way in which commands report."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pointsdf_cli.cli.printable import printable, printable_json
from pointsdf_cli.errors import InputError
from pointsdf_cli.io.strict_json import to_json

if TYPE_CHECKING:
    from pointsdf_cli.io.batch import StageReport

Seed = Annotated[int, typer.Option(help="Random seed.")]
Jobs = Annotated[int, typer.Option("--jobs", "-j", help="Number of processes; 0 uses all cores.")]
EachJobs = Annotated[
    int,
    typer.Option("--jobs", "-j", help="With --each: number of processes; 0 uses all cores."),
]
EachSkipBad = Annotated[
    bool,
    typer.Option(
        "--skip-bad", help="With --each: exit with 0 even if some inputs could not be used."
    ),
]
Threads = Annotated[
    int, typer.Option(min=0, help="Number of processor threads; 0 uses the idle ones.")
]
Robot = Annotated[Path | None, typer.Option(help="Robot YAML.  [default: LBR4 with Allegro hand]")]
Device = Annotated[str, typer.Option(help="Compute device: cpu, cuda or cuda:N.")]
Sensor = Annotated[
    str,
    typer.Option(
        metavar="ideal|structured-light|stereo",
        help="Depth camera to simulate.",
    ),
]
Server = Annotated[
    str | None,
    typer.Option(
        metavar="URL",
        help="Plan on a running `rgrasp serve`, such as http://127.0.0.1:8765; its token is read "
        "from RGRASP_TOKEN.",
        show_default=False,
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
        show_default=False,
    ),
]
Intrinsics = Annotated[
    str | None,
    typer.Option(
        metavar="K.json",
        help="Intrinsics of a depth image: K matrix, ROS camera_info, RealSense or Open3D "
        "intrinsics (JSON or YAML), or kinect2.",
        show_default=False,
    ),
]
DepthScale = Annotated[
    float | None,
    typer.Option(
        help="Metres per unit of a depth image [default: 0.001 for integers, 1 for floats].",
        show_default=False,
    ),
]
Mask = Annotated[
    str | None,
    typer.Option(
        metavar="MASK.png",
        help="Mask image of the object, from any segmenter: its nonzero pixels; MASK.png:7 "
        "takes the pixels of value 7.",
        show_default=False,
    ),
]
CameraPose = Annotated[
    str | None,
    typer.Option(
        metavar="POSE",
        help="Camera pose in the world: X,Y,Z,QW,QX,QY,QZ, or a file. For trying out, "
        "table[:X,Y]: z = 0 is the observed table, the object at 0.6,0 or X,Y.",
        show_default=False,
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


def job_count(jobs: int) -> int:
    """The number of processes for `--jobs`.

    Raises:
        InputError: Negative, or absurdly many.
    """
    if not 0 <= jobs <= 1024:
        raise InputError(f"{jobs} jobs", where="--jobs", allowed="0 (all cores) to 1024")
    return jobs or len(os.sched_getaffinity(0))


def check_seed(seed: int) -> int:
    """`seed`, if it can seed a generator.

    Raises:
        InputError: Negative or beyond 63 bits.
    """
    if not 0 <= seed < 2**63:
        raise InputError(f"{seed} is no seed", where="--seed", allowed="0 to 2⁶³ − 1")
    return seed


def check_table_name(out: Path, beside: tuple[str, ...]) -> None:
    """Refuse a table path with one of these suffixes, which are written beside it.

    Raises:
        InputError: It has such a suffix.
    """
    if not out.name or out.suffix.lower() in beside:
        raise InputError(
            f"{out} is no name of a file, or that of what goes beside the table",
            where="--out",
            allowed="such as table.json",
        )


def check_suffix(path: Path, option: str, suffixes: tuple[str, ...]) -> None:
    """Refuse a file a name by which it would be read as something else.

    Raises:
        InputError: It has none of the suffixes.
    """
    from pointsdf_cli.errors import InputError

    if path.suffix.lower() not in suffixes:
        raise InputError(
            f"{path} does not end in {' or '.join(suffixes)}, and other commands would not read it",
            where=option,
            allowed=f"such as {path.stem or 'result'}{suffixes[0]}",
        )


def say_if_from_another(
    reporter: Reporter, checkpoint: Path | None, grasp_checkpoint: Path | None
) -> None:
    """Say so where the success network learned from another reconstruction than it will read.

    Raises:
        InputError: No such checkpoint.
    """
    from pointsdf_cli.models.grasp_checkpoint import learned_from_another
    from pointsdf_cli.models.registry import default_checkpoint

    if checkpoint is None and grasp_checkpoint is None:
        return
    read = checkpoint or default_checkpoint()
    other = learned_from_another(grasp_checkpoint, read)
    if other is not None:
        reporter.say(
            f"the success network learned from the reconstruction {other} and reads {read}: its "
            "probabilities need not hold there (train-gs --sdf trains one for it)"
        )


def labels_of(checkpoints: list[Path]) -> list[str]:
    """Short names: each directory's own, or its whole path where two would be the same.

    Raises:
        InputError: A name is given twice.
    """
    from pointsdf_cli.errors import InputError

    whole = [path.resolve() for path in checkpoints]
    if len(set(whole)) < len(whole):
        raise InputError("a checkpoint is given twice", where="--checkpoint", allowed="each once")
    names = [path.name for path in whole]
    return [
        name if names.count(name) == 1 else str(path)
        for name, path in zip(names, whole, strict=True)
    ]


def cache_beside(folder: Path) -> Path:
    """Cache folder of what is computed from a folder's grasps: `grasps-cache` beside `grasps`."""
    whole = folder.resolve()
    return whole.with_name(whole.name + "-cache")


def check_picture(path: Path | None, force: bool) -> Path | None:
    """The path of a picture, if a PNG can be written there; known before the work, not after.

    Raises:
        InputError: It has another suffix, exists already, or its folder cannot be written.
    """
    from pointsdf_cli.errors import InputError
    from pointsdf_cli.io.atomic import require_folder, require_new

    if path is None:
        return None
    if path.suffix.lower() != ".png" or path.is_dir():
        raise InputError("is no picture's name", where=path, allowed="a file that ends in .png")
    require_folder(require_new(path, force).parent)
    return path


def check_device(name: str) -> None:
    """Refuse an unknown kind of device, without importing torch.

    Raises:
        InputError: Neither cpu nor cuda nor cuda:N.
    """
    kind, colon, number = name.partition(":")
    numbered = not colon or number.isdecimal()
    if kind not in ("cpu", "cuda") or not numbered:
        raise InputError(f"no device {name!r}", where="--device", allowed="cpu, cuda, cuda:N")


def torch_device(name: str) -> str:
    """`name`, if torch can compute there.

    Raises:
        InputError: No such kind of device, or not on this machine.
    """
    check_device(name)
    import torch

    device = torch.device(name)
    if device.type == "cuda" and (device.index or 0) >= torch.cuda.device_count():
        raise InputError(
            f"{name} is not on this machine ({torch.cuda.device_count()} CUDA devices)",
            where="--device",
            allowed="cpu" + "".join(f", cuda:{k}" for k in range(torch.cuda.device_count())),
        )
    return name


@dataclass(frozen=True)
class Reporter:
    """Progress and messages on stderr, the result on stdout.

    Attributes:
        quiet: Nothing on stderr but errors.
        as_json: The result as one JSON object instead of lines.
    """

    quiet: bool = False
    as_json: bool = False

    def say(self, text: str) -> None:
        """One line of progress on stderr."""
        if not self.quiet:
            print(printable(text), file=sys.stderr, flush=True)

    def result(self, values: Mapping[str, Any], lines: list[str] | None = None) -> None:
        """The command's result: `values` as JSON, or `lines` (by default "name: value")."""
        if self.as_json:
            text = printable_json(to_json(values))
            try:
                text.encode(getattr(sys.stdout, "encoding", None) or "utf-8")
            except UnicodeEncodeError:  # then all of it as escapes, which JSON has its own of
                text = json.dumps(json.loads(text))
            print(text)
        else:
            for line in lines if lines is not None else [f"{k}: {v}" for k, v in values.items()]:
                print(printable(line))

    @contextmanager
    def progress(self, title: str, total: int) -> Iterator[Progress]:
        """A progress bar on a terminal, an occasional line elsewhere; nothing when quiet."""
        progress = Progress(title, total, self.quiet)
        try:
            yield progress
        finally:
            progress.close()


class Progress:
    """Counts finished files; `advance` may be given to `run_stage` as `on_done`."""

    _LINE_EVERY = 10.0

    def __init__(self, title: str, total: int, quiet: bool) -> None:
        self._title, self._total, self._quiet = title, total, quiet
        self._count = 0
        self._started = self._spoke = time.monotonic()
        self._bar: Any = None
        if not quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, TimeRemainingColumn
            from rich.progress import Progress as Bar

            self._bar = Bar(
                "{task.description}",
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
                console=Console(stderr=True),
            )
            self._bar.start()
            self._task = self._bar.add_task(title, total=total)

    def advance(self, name: str, _result: object = None) -> None:
        """Count one more finished file."""
        self._count += 1
        if self._bar:
            self._bar.update(self._task, advance=1, description=f"{self._title} {name[-32:]}")
            return
        now = time.monotonic()
        if not self._quiet and (now - self._spoke > self._LINE_EVERY):
            self._spoke = now
            left = (now - self._started) / self._count * (self._total - self._count)
            print(
                f"{self._title}: {self._count} of {self._total}, {left:.0f} s left",
                file=sys.stderr,
                flush=True,
            )

    def close(self) -> None:
        """Take the bar off the terminal."""
        if self._bar:
            self._bar.stop()


def finish_stage(
    reporter: Reporter,
    report: StageReport[Any],
    out: Path,
    skip_bad: bool,
    values: Mapping[str, Any],
    lines: list[str],
) -> None:
    """Print a stage's result, then the inputs it could not use.

    Raises:
        InputError: Some inputs were refused and `--skip-bad` was not given.
    """
    refused = {name: error.what for name, error in report.refused}
    counts = {"made": len(report.made), "kept": len(report.kept), "refused": len(refused)}
    if report.made or report.kept or not refused:
        reporter.result(
            {"out": out, **counts, "seconds": round(report.seconds, 3), **values, "bad": refused},
            [
                f"{out}: {counts['made']} made, {counts['kept']} there already, "
                f"{counts['refused']} refused, in {report.seconds:.1f} s",
                *lines,
            ],
        )
    if skip_bad and (report.made or report.kept):
        for _, error in report.refused:
            reporter.say(f"skipped: {error.message}")
        return
    report.raise_if_refused()
