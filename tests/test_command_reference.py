"""docs/commands.md is what --help says today."""

from __future__ import annotations

import importlib.metadata
import runpy
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]


def test_the_command_reference_is_up_to_date() -> None:
    typer = f"typer=={importlib.metadata.version('typer')}"
    if typer not in (REPOSITORY / "constraints.txt").read_text(encoding="utf-8").split():
        pytest.skip(f"{typer} lays its help out in another way")
    script = runpy.run_path(str(REPOSITORY / "pipelines" / "command_reference.py"))
    written = (REPOSITORY / "docs" / "commands.md").read_text(encoding="utf-8")
    assert script["reference"]() == written, (
        "type: .venv/bin/python pipelines/command_reference.py docs/commands.md"
    )
