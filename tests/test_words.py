"""Plain words: how docstrings, descriptions and help texts begin, and names that were replaced."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
ARRAYS = Path("pointsdf_cli/geometry/arrays.py")
BEGINNINGS = re.compile(r"(Of|Whose|What|Where|About|How|Which|Who)\b")
ENTRY = re.compile(r"\s+[\w, *`]+: (?P<text>.*)")

RETIRED = {
    "twin",
    "twins",
    "halvings",
    "spares",
    "is_spare",
    "Redraws",
    "Sight",
    "Mind",
    "Contender",
    "Drawn",
    "Satisfied",
    "lowered",
    "sign_scale",
    "object_room",
    "worst_room",
    "least_room",
    "FieldGrid",
}
"""Identifiers that have given way to the field's terms."""


@cache
def trees() -> dict[Path, ast.Module]:
    folders = ("pointsdf_cli", "pipelines", "benchmarks", "experiments")
    paths = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    return {path.relative_to(ROOT): ast.parse(path.read_text()) for path in paths}


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Docstrings and the strings below attributes, with their lines."""
    for node in ast.walk(tree):
        match node:
            case ast.Expr(ast.Constant(str() as text)):
                yield node.lineno, text


def descriptions(text: str) -> Iterator[str]:
    """The beginning of a docstring and of each entry of its lists."""
    first, *others = text.split("\n")
    yield first.strip()
    for line in others:
        if entry := ENTRY.match(line):
            yield entry["text"]


def help_texts(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Values of the keyword `help`."""
    for node in ast.walk(tree):
        match node:
            case ast.keyword("help", ast.Constant(str() as text)):
                yield node.value.lineno, text


def identifiers(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Names, attributes, arguments and definitions."""
    for node in ast.walk(tree):
        for field in ("id", "attr", "arg", "name"):
            name = getattr(node, field, None)
            if isinstance(name, str):
                yield getattr(node, "lineno", 0), name


def test_the_search_finds_what_it_looks_for() -> None:
    tree = ast.parse('def f(twin):\n    """Of it.\n\n    Args:\n        a: What.\n    """\n')
    (_, text), *_ = docstrings(tree)
    assert [bool(BEGINNINGS.match(one)) for one in descriptions(text)] == [True, True]
    assert "twin" in {name for _, name in identifiers(tree)} & RETIRED


def test_descriptions_begin_with_a_noun_or_an_imperative() -> None:
    wrong = [
        f"{path}:{line}: {one}"
        for path, tree in trees().items()
        for line, text in docstrings(tree)
        for one in descriptions(text)
        if BEGINNINGS.match(one)
    ]
    assert not wrong, "\n".join(wrong)


def test_help_texts_begin_with_a_noun_or_an_imperative() -> None:
    wrong = [
        f"{path}:{line}: {text}"
        for path, tree in trees().items()
        for line, text in help_texts(tree)
        if BEGINNINGS.match(text)
    ]
    assert not wrong, "\n".join(wrong)


def test_retired_names_stay_away() -> None:
    wrong = [
        f"{path}:{line}: {name}"
        for path, tree in trees().items()
        for line, name in identifiers(tree)
        if name in RETIRED
    ]
    assert not wrong, "\n".join(wrong)


def test_array_types_have_one_home() -> None:
    shared = {"Array", "Mask", "Indices"}
    wrong = [
        f"{path}:{node.lineno}"
        for path, tree in trees().items()
        for node in tree.body
        if isinstance(node, ast.Assign) and {ast.unparse(one) for one in node.targets} & shared
        if path != ARRAYS and "NDArray" in ast.unparse(node.value)
    ]
    assert not wrong, "\n".join(wrong)
