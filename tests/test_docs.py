"""README and docs say what is true: every code block runs, parses, or names what exists.

`doc_blocks.py` says what the blocks' first words mean.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import pytest
import typer.main
import yaml
from doc_blocks import LANGUAGES, Block, blocks, commands

from pointsdf_cli.cli.app import app_of

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = [REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md"))]
BLOCKS = [block for page in PAGES for block in blocks(page)]
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
ANCHOR = re.compile(r"\]\(([^)#\s]*)#([^)\s]+)\)")
CODE_NAME = re.compile(r"`((?:pointsdf_cli/)?[a-z_]+/[a-z_]+\.py)(?::([A-Za-z_.]+))?`")


def name(block: Block) -> str:
    return f"{block.page.name}:{block.line}"


def parse_rgrasp(words: Sequence[str]) -> None:
    """Parse a command line with the real commands, and run nothing.

    Raises:
        AssertionError: An option, command or value is not known.
    """
    command, context, rest = typer.main.get_command(app_of()), None, list(words)
    told = io.StringIO()
    while True:
        try:
            with contextlib.redirect_stdout(told), contextlib.redirect_stderr(told):
                parsed = command.make_context("rgrasp", rest, parent=context)
        except SystemExit:  # --help and --version leave
            return
        except Exception as error:
            if type(error).__name__ == "Exit":
                return
            message = error.format_message() if hasattr(error, "format_message") else str(error)
            raise AssertionError(f"rgrasp {' '.join(words)}: {message}") from error
        if not hasattr(command, "resolve_command"):
            return
        remaining = [*getattr(parsed, "_protected_args", []), *parsed.args]
        try:
            _, command, rest = command.resolve_command(parsed, remaining)
        except Exception as error:
            raise AssertionError(f"rgrasp {' '.join(words)}: {error}") from error
        context = parsed


def check_command(words: list[str]) -> None:
    """A command of a `sh` block, not run: it must be one that could be."""
    program, *rest = words
    if "rgrasp" in words and program in ("rgrasp", "torchrun", "time", "nice"):
        parse_rgrasp(words[words.index("rgrasp") + 1 :])
    elif program == "make":
        targets = re.findall(r"^([a-z]+):", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
        wanted = [word for word in rest if not word.startswith("-") and "=" not in word]
        assert set(wanted) <= set(targets), words
    elif program in ("python", ".venv/bin/python", "bash", "snakemake") or "/" in program:
        check_script(rest if program in ("python", ".venv/bin/python", "bash") else words)


def check_script(words: list[str]) -> None:
    """A script or module of the repository with its options, which must stand in its text."""
    if words[:1] == ["-m"]:
        folder = REPOSITORY / words[1].replace(".", "/")
        if not folder.exists() and not folder.with_suffix(".py").exists():
            return  # a module of someone else's
        script, options = (folder / "__main__.py"), words[2:]
    elif words[:1] == ["snakemake"]:
        script, options = REPOSITORY / words[words.index("-s") + 1], []
    elif words and not words[0].startswith("-"):
        script, options = REPOSITORY / words[0], words[1:]
    else:
        return
    assert script.is_file(), f"{script} is not there"
    text = script.read_text(encoding="utf-8")
    for option in options:
        if option.startswith("--"):
            assert f'"{option.split("=")[0]}"' in text, f"{script.name} has no {option}"


@pytest.mark.parametrize("block", BLOCKS, ids=name)
def test_a_block_is_what_it_says(block: Block) -> None:
    assert block.language in LANGUAGES, f"{name(block)}: write ```{'|'.join(LANGUAGES)}"
    if block.language == "sh":
        for words in commands(block.text):
            check_command(words)
    elif block.language == "python":
        compile(block.text, name(block), "exec")
    elif block.language == "yaml":
        assert yaml.safe_load(block.text) is not None
    elif block.language == "json":
        json.loads(block.text)
    elif block.language == "xml":
        ET.fromstring(block.text)


RUN = [page for page in PAGES if any(block.run for block in blocks(page))]
FOLDERS = ("assets", "benchmarks", "experiments", "pipelines", "tests")


@pytest.mark.pages
@pytest.mark.parametrize("page", RUN, ids=lambda page: page.name)
def test_the_blocks_of_a_page_run_in_order(page: Path, tmp_path: Path) -> None:
    for folder in FOLDERS:
        (tmp_path / folder).symlink_to(REPOSITORY / folder)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for block in blocks(page):
        if block.run:
            shell = [sys.executable, "-c"] if block.language == "python" else ["bash", "-euc"]
            done = subprocess.run(
                [*shell, block.shrunken], cwd=tmp_path, env={**os.environ, "PATH": path},
                capture_output=True, text=True, check=False, timeout=300,
            )  # fmt: skip
            assert done.returncode == 0, f"{name(block)}\n{done.stdout}\n{done.stderr}"


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.language in ("sh", "python")], ids=name)
def test_commands_are_run_or_say_why_not(block: Block) -> None:
    advice = f"```{block.language} run, or <!-- run by: … -->, or <!-- not run: … -->"
    assert block.run or block.run_by or block.reason, f"{name(block)}: {advice}"


def what_runs(words: Sequence[str]) -> str:
    """A command without its options: `rgrasp plan`, `make demo`, or a script's name."""
    if words[0] in ("rgrasp", "make"):
        return " ".join(words[:2])
    return Path(words[1] if words[0].endswith("python") else words[0]).name


def run_in(file: Path) -> str:
    """What a page's blocks or a script run, as text."""
    if file.suffix == ".md":
        return "\n".join(block.text for block in blocks(file) if block.run)
    lines = file.read_text(encoding="utf-8").splitlines()
    return "\n".join(line for line in lines if not line.lstrip().startswith("#"))


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.run_by], ids=name)
def test_what_is_run_elsewhere_is_run_there(block: Block) -> None:
    there = run_in(REPOSITORY / block.run_by)
    for words in commands(block.text):
        assert what_runs(words) in there, f"{name(block)}: {block.run_by} does not run {words}"


def test_what_only_a_comment_names_is_not_run(tmp_path: Path) -> None:
    script = tmp_path / "run"
    script.write_text("# make coffee\nmake tea\n")
    assert what_runs(["make", "tea", "-j2"]) in run_in(script)
    assert what_runs(["make", "coffee"]) not in run_in(script)
    assert what_runs([".venv/bin/python", "pipelines/a.py", "--b"]) == "a.py"


def test_sizes_are_put_in_place() -> None:
    text = "rgrasp plan a --seed 3 \\\n--json\nrgrasp mesh a\nJOBS=4 python b/run.py --n 9"
    sizes = ("plan.seed=1", "mesh.quiet", "JOBS=1", "n=2")
    block = Block(Path("page.md"), 1, "sh", text, True, sizes)
    told = "rgrasp plan --seed 1 a  --json\nrgrasp mesh --quiet a\nJOBS=1 python b/run.py --n 2"
    assert block.shrunken == told
    added = block._replace(sizes=("run.k=5",)).shrunken
    assert "python b/run.py --k 5 --n 9" in added
    for wrong in ("seeds=1", "trial.seed=1", "CORES=2"):
        with pytest.raises(AssertionError, match="no place"):
            _ = block._replace(sizes=(wrong,)).shrunken


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_links_to_is_there(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        if "://" not in target and not target.startswith("mailto:"):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def anchors(page: Path) -> set[str]:
    """The places in a page that a link can name, as GitHub makes them of its headings."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_place_in_a_page_that_is_linked_to_is_there(page: Path) -> None:
    for target, anchor in ANCHOR.findall(page.read_text(encoding="utf-8")):
        if "://" not in target:
            there = page.parent / target if target else page
            assert anchor in anchors(there), f"{page.name} links to {target}#{anchor}"


def test_the_studies_that_the_code_cites_are_there() -> None:
    notebook = (REPOSITORY / "docs" / "notebook.md").read_text(encoding="utf-8")
    files = (REPOSITORY / "pointsdf_cli").rglob("*.py")
    code = " ".join(path.read_text(encoding="utf-8") for path in files)
    cited = re.findall(r'docs/notebook\.md, "([^"]+)"', " ".join(code.split()))
    assert cited
    assert [title for title in cited if title not in notebook] == []


def test_the_code_that_the_method_page_names_is_there() -> None:
    text = (REPOSITORY / "docs" / "method.md").read_text(encoding="utf-8")
    found = CODE_NAME.findall(text)
    assert len(found) > 30
    for file, symbol in found:
        path = REPOSITORY / "pointsdf_cli" / file.removeprefix("pointsdf_cli/")
        assert path.is_file(), file
        last = symbol.rpartition(".")[2]
        pattern = rf"^\s*(?:def|class) {last}\b|^{last}\b\s*[:=]"
        assert not symbol or re.search(pattern, path.read_text(), re.MULTILINE), (file, symbol)


def test_a_wrong_command_would_be_noticed() -> None:
    for wrong in (["rendr"], ["render", "--vews", "3"], ["render", "--meshes", "m", "--views", "x"],
                  ["mesh"], ["objects", "fetch"]):  # fmt: skip
        with pytest.raises(AssertionError):
            parse_rgrasp(wrong)
    with pytest.raises(AssertionError):
        check_command(["make", "coffee"])
    with pytest.raises(AssertionError):
        check_command(["python", "benchmarks/bench_render.py", "--tea"])
