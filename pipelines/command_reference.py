"""The command reference, from the commands' own --help: python pipelines/command_reference.py FILE.

Without a file it is printed. tests/test_command_reference.py holds docs/commands.md against it.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path


def help_of(*command: str) -> str:
    """The --help text of a command, at a width that does not depend on the terminal."""
    done = subprocess.run(
        [sys.executable, "-m", "pointsdf_cli.cli.main", *command, "--help"],
        env={**os.environ, "COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return "\n".join(line.rstrip() for line in done.stdout.strip().splitlines()).replace(
        "python -m pointsdf_cli.cli.main", "rgrasp"
    )


def subcommands(text: str) -> list[str]:
    """The names in the last block, "Commands:", of a help text."""
    _, found, block = text.partition("Commands:\n")
    return re.findall(r"^  ([a-z][a-z-]*)", block, re.MULTILINE) if found else []


def reference() -> str:
    """The whole page."""
    parts = ["# Commands\n\nMade by `python pipelines/command_reference.py docs/commands.md`.\n"]
    queue: list[tuple[str, ...]] = [()]
    while queue:
        command = queue.pop(0)
        text = help_of(*command)
        parts.append(f"## {' '.join(('rgrasp', *command))}\n\n```text\n{text}\n```\n")
        queue = [(*command, name) for name in subcommands(text)] + queue
    return "\n".join(parts)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(reference(), encoding="utf-8")
    else:
        print(reference())
