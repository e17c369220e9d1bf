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
    values = {check.name: {"ok": check.ok, "detail": check.detail} for check in checks}
    lines = [f"{'ok  ' if c.ok else 'FAIL'}  {c.name}: {c.detail}" for c in checks]
    common.Reporter(quiet, as_json).result(values, lines)
    failed = [check.name for check in checks if not check.ok]
    if failed:
        raise RgraspError(f"{len(failed)} checks failed: {', '.join(failed)}")
