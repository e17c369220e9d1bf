"""`rgrasp doctor`: self-test of the installation."""

from __future__ import annotations

from pointsdf_cli.cli import common
from pointsdf_cli.errors import RgraspError


def doctor(quiet: common.Quiet = False, as_json: common.Json = False) -> None:
    """Check versions and processor, and test geometry, files, robot and libraries against known
    results.

    Example: rgrasp doctor
    """
    from pointsdf_cli.doctor import examine

    checks = examine()
    values = {name: {"ok": ok, "detail": detail} for name, (ok, detail) in checks.items()}
    lines = [f"{'ok  ' if ok else 'FAIL'}  {name}: {d}" for name, (ok, d) in checks.items()]
    common.Reporter(quiet, as_json).result(values, lines)
    failed = [name for name, (ok, _) in checks.items() if not ok]
    if failed:
        raise RgraspError(f"{len(failed)} checks failed: {', '.join(failed)}")
