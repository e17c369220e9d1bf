"""docs/commands.md is what --help says today."""

from __future__ import annotations

import runpy
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]


def test_the_command_reference_is_up_to_date() -> None:
    script = runpy.run_path(str(REPOSITORY / "pipelines" / "command_reference.py"))
    written = (REPOSITORY / "docs" / "commands.md").read_text(encoding="utf-8")
    assert script["reference"]() == written, (
        "type: .venv/bin/python pipelines/command_reference.py docs/commands.md"
    )
