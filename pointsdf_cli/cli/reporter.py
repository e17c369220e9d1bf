"""Reports of commands: progress and messages on stderr, the result on stdout."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pointsdf_cli.cli.printable import printable, printable_json
from pointsdf_cli.io.strict_json import to_json

if TYPE_CHECKING:
    from pointsdf_cli.io.batch import Result, StageReport, Task


@dataclass(frozen=True)
class Reporter:
    """Progress and messages on stderr, the result on stdout.

    Attributes:
        quiet: Print only errors, and warnings of too small results, on stderr.
        as_json: Print the result as one JSON object instead of lines.
    """

    quiet: bool = False
    as_json: bool = False

    def say(self, *lines: str) -> None:
        """Print lines of progress on stderr."""
        if self.quiet:
            return
        for line in lines:
            print(printable(line), file=sys.stderr, flush=True)

    def warn(self, sentence: str) -> None:
        """Print a warning on stderr, also when quiet: the result is not what was asked for."""
        print(printable(f"warning: {sentence}"), file=sys.stderr, flush=True)

    def result(self, values: Mapping[str, Any], lines: list[str] | None = None) -> None:
        """Print the command's result: `values` as JSON, or `lines` (by default "name: value")."""
        if self.as_json:
            text = printable_json(to_json(values))
            try:
                text.encode(getattr(sys.stdout, "encoding", None) or "utf-8")
            except UnicodeEncodeError:  # escape non-ASCII characters, as JSON allows
                text = json.dumps(json.loads(text))
            print(text)
        else:
            for line in lines if lines is not None else [f"{k}: {v}" for k, v in values.items()]:
                print(printable(line))

    def progress(self, title: str, total: int) -> closing[Progress]:
        """A progress bar on a terminal, an occasional line elsewhere; nothing when quiet."""
        return closing(Progress(title, total, self.quiet))

    def stage(
        self,
        title: str,
        tasks: Sequence[tuple[str, Task]],
        work: Callable[[Task], Result | None],
        jobs: int,
        folders: Iterable[Path] = (),
        on_result: Callable[[Result | None], None] | None = None,
    ) -> StageReport[Result]:
        """Run a stage as `run_stage` does, with its progress; `on_result` is told each result."""
        from pointsdf_cli.io.batch import run_stage

        def done(name: str, result: Result | None) -> None:
            progress.advance(name)
            if on_result is not None:
                on_result(result)

        with self.progress(title, len(tasks)) as progress:
            return run_stage(tasks, work, jobs=jobs, folders=folders, on_done=done)

    def finish(
        self,
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
            seconds = round(report.seconds, 3)
            head = (
                f"{out}: {counts['made']} made, {counts['kept']} there already, "
                f"{counts['refused']} refused, in {report.seconds:.1f} s"
            )
            told = {"out": out, **counts, "seconds": seconds, **values, "bad": refused}
            self.result(told, [head, *lines])
        if skip_bad and (report.made or report.kept):
            self.say(*(f"skipped: {error.message}" for _, error in report.refused))
            return
        report.raise_if_refused()


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
            from rich.markup import escape

            told = escape(printable(f"{self._title} {name[-32:]}"))
            self._bar.update(self._task, advance=1, description=told)
            return
        now = time.monotonic()
        if not self._quiet and (now - self._spoke > self._LINE_EVERY):
            self._spoke = now
            left = (now - self._started) / self._count * (self._total - self._count)
            told = f"{self._title}: {self._count} of {self._total}, {left:.0f} s left"
            print(told, file=sys.stderr, flush=True)

    def close(self) -> None:
        """Remove the bar from the terminal."""
        if self._bar:
            self._bar.stop()
