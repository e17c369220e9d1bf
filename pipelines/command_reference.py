"""The command reference, from the commands' own --help: python pipelines/command_reference.py FILE.

One table a command. Options that several commands share, word for word, are explained once at the
top and only named below. Without a file it is printed. tests/test_command_reference.py holds
docs/commands.md against it.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

UNLISTED = ("--help", "-completion")
"""Options of every command line that are left out."""
UNNAMED = ("-q, --quiet", "--json")
"""Shared options that nearly every command takes: they are explained, and not named again."""
SHARED_BY = 3
"""Options with the same words in so many commands are explained once."""
_HEADING = re.compile(r"^(Arguments|Options|Commands):$", re.MULTILINE)
_ENTRY = re.compile(r"^  (\S(?:.*?\S)?)(?:  +(\S.*))?$")


class Entry(NamedTuple):
    """An option or argument: its names, what it takes, and its explanation."""

    names: str
    takes: str
    text: str

    @property
    def row(self) -> str:
        shown = f"`{self.names} {self.takes}`" if self.takes else f"`{self.names}`"
        return f"|{shown}|{self.text}|"


class Help(NamedTuple):
    """A help text in parts."""

    usage: str
    about: str
    examples: list[str]
    entries: list[Entry]
    subcommands: list[str]


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


def entries(block: str) -> list[Entry]:
    """The entries of an "Options:" or "Arguments:" block."""
    found: list[tuple[str, list[str]]] = []
    for line in block.splitlines():
        if match := _ENTRY.match(line):
            found.append((match[1], [match[2]] if match[2] else []))
        elif line.strip() and found:
            found[-1][1].append(line.strip())
    rows = [_entry(head, _joined(lines)) for head, lines in found]
    return [row for row in rows if not row.names.endswith(UNLISTED)]


def _joined(lines: Iterable[str]) -> str:
    """Lines as one; a word that was broken at its hyphen is joined again."""
    return re.sub(r"(\w-)\n", r"\1", "\n".join(lines)).replace("\n", " ")


def _entry(head: str, text: str) -> Entry:
    names = re.match(r"(?:-\w, )?--[\w-]+|[\w.]+", head)
    takes = head[names.end() :].strip() if names else ""
    # What type a value has is clear from its default or from the words.
    if re.fullmatch(r"<(path|(int|float)( range)?|str|list\[\w+\])>", takes):
        takes = ""
    text = re.sub(r"\s*\[required\]$", " Required.", text)
    text = re.sub(r"\s*\[default:\s*([^\]]*?)(; x>=0)?\]\.?$", r" (\1)", text)
    text = re.sub(r"\s*\[x>=0\]$", "", text).replace("((", "(").replace("))", ")")
    return Entry(names[0] if names else head, takes.replace("|", "\\|"), text.replace("|", "\\|"))


def parts_of(text: str) -> Help:
    """A help text taken apart."""
    pieces = _HEADING.split(text)
    usage, *paragraphs = re.split(r"\n\s*\n", pieces[0].strip())
    joined = [_joined(line.strip() for line in p.splitlines()) for p in paragraphs]
    examples = [e.strip() for p in joined if "Example: " in p for e in p.split("Example: ")[1:]]
    about = " ".join(p.split("Example: ")[0].strip() for p in joined).strip()
    rows: list[Entry] = []
    commands: list[str] = []
    for title, block in zip(pieces[1::2], pieces[2::2], strict=True):
        if title == "Commands":
            commands = re.findall(r"^  ([a-z][a-z-]*)", block, re.MULTILINE)
        else:
            rows += entries(block)
    return Help(" ".join(usage.removeprefix("Usage: ").split()), about, examples, rows, commands)


def reference() -> str:
    """The whole page."""
    helps: dict[tuple[str, ...], Help] = {}
    queue: list[tuple[str, ...]] = [()]
    while queue:
        command = queue.pop(0)
        helps[command] = parts_of(help_of(*command))
        queue = [(*command, name) for name in helps[command].subcommands] + queue
    uses = Counter(entry for text in helps.values() for entry in text.entries)
    shared = [entry for entry, count in uses.items() if count >= SHARED_BY]
    named = [entry for entry in shared if entry.names not in UNNAMED]
    page = ["# Commands", "Made by `python pipelines/command_reference.py docs/commands.md`."]
    page.append("Every command takes `--help`, most `--quiet` and `--json`. Shared options:")
    page.append(_table(shared))
    for command, text in helps.items():
        page.append(f"## {' '.join(('rgrasp', *command))}")
        page.append(text.about)
        if text.examples:
            page.append("```text\n" + "\n".join(text.examples) + "\n```")
        if own := [entry for entry in text.entries if entry not in shared]:
            page.append(_table(own))
        if also := [f"`{e.names.split(', ')[-1]}`" for e in text.entries if e in named]:
            page.append(f"Shared: {' '.join(also)}")
    return "\n\n".join(part for part in page if part) + "\n"


def _table(rows: list[Entry]) -> str:
    return "\n".join(["|option|meaning (default)|", "|---|---|", *(entry.row for entry in rows)])


if __name__ == "__main__":
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(reference(), encoding="utf-8")
    else:
        print(reference())
