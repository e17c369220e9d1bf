"""The code blocks of a Markdown page, and the commands in them.

A fenced block says by its first words what it is and what a test does with it:

    sh          commands: each is parsed by the program that it names, and not run
    sh run      commands: run, in a folder of the page's own with `assets/` in it (seconds only)
    python      compiled; `python run` is run like `sh run`
    yaml json xml   parsed
    text        output, trees, formulas: left alone

An indented block that begins with a command is taken as `sh`.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import NamedTuple

LANGUAGES = ("sh", "python", "yaml", "json", "xml", "text")
PROGRAMS = ("rgrasp", "make", "python", ".venv/bin/python", "bash", "torchrun", "snakemake", "pip")
_VARIABLE = re.compile(r"^[A-Z_]+=\S*$")


class Block(NamedTuple):
    """One block: its page, the line it begins in, its language, whether to run it, its text."""

    page: Path
    line: int
    language: str
    run: bool
    text: str


def blocks(page: Path) -> list[Block]:
    """All code blocks of a page, in order."""
    found, lines = [], page.read_text(encoding="utf-8").splitlines()
    at = 0
    while at < len(lines):
        line = lines[at]
        if line.lstrip().startswith("```"):
            language, *tags = line.strip().strip("`").split() or [""]
            indent = len(line) - len(line.lstrip())
            end = next(k for k in range(at + 1, len(lines)) if lines[k].strip() == "```")
            text = "\n".join(inner[indent:] for inner in lines[at + 1 : end])
            found.append(Block(page, at + 1, language, "run" in tags, text))
            at = end + 1
        elif line.startswith("    ") and (at == 0 or not lines[at - 1].strip()):
            end = at
            while end < len(lines) and lines[end].startswith("    "):
                end += 1
            text = "\n".join(inner[4:] for inner in lines[at:end])
            if _program(text.splitlines()[0]):
                found.append(Block(page, at + 1, "sh", False, text))
            at = end
        else:
            at += 1
    return found


def commands(text: str) -> list[list[str]]:
    """The words of each command in a `sh` block; comments, variables and loops are left out."""
    joined = text.replace("\\\n", " ")
    found = []
    for line in joined.splitlines():
        for part in re.split(r"&&|\|\||;|(?<!\\)\|", line.split(" #")[0]):
            if part.lstrip().startswith("#"):
                break
            words = shlex.split(re.split(r"\s[0-9]?>", part)[0])
            while words and _VARIABLE.match(words[0]):
                words = words[1:]
            words = [word for word in words if word != "…"]  # "and so on"
            if words:
                found.append(words)
    return found


def _program(line: str) -> bool:
    words = [word for word in line.split() if not _VARIABLE.match(word)]
    return bool(words) and (words[0] in PROGRAMS or words[0].startswith("pipelines/"))
