"""The code blocks of a Markdown page, and the commands in them.

A fenced block says by its first words what it is and what a test does with it:

    sh run              commands: run, in a folder of the page's own (see `test_docs.py`)
    sh run count=3      ... with `--count 3` in place of the number that the reader sees
    sh run plan.quiet   ... with `--quiet` added to every `rgrasp plan`; `plan.seed=3` likewise, and
                        `bench_mesh.threads=1` to every `python …/bench_mesh.py`
    sh run JOBS=1       ... with that variable in place of the one that the reader sees
    sh                  parsed by the programs that they name, and not run here: a comment before
                        the block names the page or script that runs these commands, as
                        <!-- run by: .ci/run -->, or says why nothing does, as
                        <!-- not run: it downloads 600 MB -->
    python run          run; `python` alone is compiled
    yaml json xml       parsed
    text                output, trees, formulas: left alone

Comments, which readers do not see, prepare what a block needs:
<!-- run: cp assets/clouds/mug.ply . -->
An indented block that begins with a command is a mistake: nothing would look at it.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import NamedTuple

LANGUAGES = ("sh", "python", "yaml", "json", "xml", "text", "prepare")
PROGRAMS = ("rgrasp", "make", "python", ".venv/bin/python", "bash", "torchrun", "snakemake", "pip")
_VARIABLE = re.compile(r"^[A-Z_]+=.*$", re.DOTALL)
_COMMENT = re.compile(r"^<!-- (run|run by|not run): (.*?) ?-->$")


class Block(NamedTuple):
    """One block: its page, the line it begins in, its language, its text, and whether to run it.

    `sizes` are the words after `run`; `run_by` names the file that runs a block's commands, and
    `reason` says why nothing does.
    """

    page: Path
    line: int
    language: str
    text: str
    run: bool = False
    sizes: tuple[str, ...] = ()
    run_by: str = ""
    reason: str = ""

    @property
    def shrunken(self) -> str:
        """The text with the sizes that a test can afford.

        Raises:
            AssertionError: A size that is nowhere in the block.
        """
        text = self.text.replace("\\\n", " ")
        for size in self.sizes:
            text, count = _resize(text, size)
            assert count, f"{self.page.name}:{self.line}: no place for {size}"
        return text


def _resize(text: str, size: str) -> tuple[str, int]:
    name, given, value = size.partition("=")
    if name.isupper():
        return re.subn(rf"\b{name}=\S+", size, text)
    command, _, option = name.rpartition(".")
    option = f"--{option}"
    with_value = f"{option} {value}" if given else option
    if not command:
        return re.subn(rf"{option}[ =]+\S+", with_value, text)
    program = re.compile(rf"\brgrasp {command.replace('.', ' ')}(?= )|\b{command}\.py\b")
    lines, count = [], 0
    for line in text.split("\n"):
        if found := program.search(line):
            line = re.sub(rf" {option}[ =]+\S+", "", line) if given else line
            line = program.sub(f"{found[0]} {with_value}", line, count=1)
            count += 1
        lines.append(line)
    return "\n".join(lines), count


def blocks(page: Path) -> list[Block]:
    """All code blocks of a page, in order; comments that prepare are blocks as well."""
    found, lines = [], page.read_text(encoding="utf-8").splitlines()
    at, said = 0, {"run by": "", "not run": ""}
    while at < len(lines):
        line = lines[at]
        comment = _COMMENT.match(line.strip())
        if comment and comment[1] == "run":
            found.append(Block(page, at + 1, "prepare", comment[2], run=True))
        elif comment:
            said[comment[1]] = comment[2]
        elif line.lstrip().startswith("```"):
            language, *tags = line.strip().strip("`").split() or [""]
            indent = len(line) - len(line.lstrip())
            end = next(k for k in range(at + 1, len(lines)) if lines[k].strip() == "```")
            text = "\n".join(inner[indent:] for inner in lines[at + 1 : end])
            run = tags[:1] == ["run"]
            found.append(Block(page, at + 1, language, text, run, tuple(tags[1:]), *said.values()))
            at, said = end, dict.fromkeys(said, "")
        elif line.startswith("    ") and (at == 0 or not lines[at - 1].strip()) and _program(line):
            found.append(Block(page, at + 1, "indented", line))
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
