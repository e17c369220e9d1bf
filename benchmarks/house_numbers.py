"""Shape of Python packages side by side: sizes, stated shapes and units, comments.

    pip download --no-deps mink pin-pink almond-pyroki && for f in *.whl; do unzip -q $f; done
    python benchmarks/house_numbers.py pointsdf_cli mink pink pyroki [--long]

Each argument is a package's source folder; nothing is imported. Printed is the Markdown table of
docs/design.md. Empty modules do not count. Lines of a function include its docstring. *Public* is
every function and method without a leading underscore, in a class without one; those that take or
return arrays have `Array`, `ndarray`, `Tensor`, `Float[…]` or the like in their signature. A shape
is stated by brackets or parentheses with a dimension in the signature or the docstring of the
function or its class ("[N, 3]", "(3,)", "*batch"); a unit by its name or sign there ("m", "[rad]").
A pose or a unit vector has no unit, so no package can reach 100%. `--long` lists what exceeds 350
lines a module or 60 a function.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

MODULE, FUNCTION = 350, 60
ARRAY = re.compile(r"Array|ndarray|Tensor|Float\[|Int\[|Bool\[|Mask\b|Indices\b|SE3|SO3")
SHAPE = re.compile(
    r"\[(?:\.\.\.|[A-Z]|\d|\*)[\w., *×+]*\]|\((?:\.\.\.|\w+|\*\w+)(?:,\s*\w*)+\)|\*batch"
)
UNIT = re.compile(
    r"(?<![\w.])(?:mm|cm|m|rad|s|ms|ns|px|kg|N|Hz|m/s|rad/s|N m|m²|1/m|"
    r"met(?:re|er)s?|radians?|degrees?|seconds?|pixels?)(?![\w'’])"
)


@dataclass
class Numbers:
    """Measurements of one package."""

    modules: dict[str, int] = field(default_factory=dict)
    functions: dict[str, int] = field(default_factory=dict)
    public: int = 0
    documented: int = 0
    with_arrays: int = 0
    shapes: int = 0
    units: int = 0
    comments: int = 0
    docstrings: int = 0
    code: int = 0


def measure(folder: Path) -> Numbers:
    """The numbers of all modules below a folder."""
    found = Numbers()
    for path in sorted(folder.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if not text.strip():
            continue
        name = str(path.relative_to(folder))
        found.modules[name] = len(text.splitlines())
        tree = ast.parse(text)
        count_lines(text, tree, found)
        for function, owners in functions(tree):
            size = (function.end_lineno or 0) - function.lineno + 1
            found.functions[f"{name}:{function.lineno} {function.name}"] = size
            if not any(one.name.startswith("_") for one in (function, *owners)):
                count_public(function, owners, found)
    return found


def functions(
    node: ast.AST, owners: tuple[ast.ClassDef, ...] = ()
) -> Iterator[tuple[ast.FunctionDef | ast.AsyncFunctionDef, tuple[ast.ClassDef, ...]]]:
    """Functions and methods with the classes around them; functions in functions do not count."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            yield child, owners
        elif isinstance(child, ast.ClassDef):
            yield from functions(child, (*owners, child))
        else:
            yield from functions(child, owners)


def count_public(
    function: ast.FunctionDef | ast.AsyncFunctionDef,
    owners: tuple[ast.ClassDef, ...],
    found: Numbers,
) -> None:
    """Add one public function: documented or not, and what it says of its arrays."""
    annotations = [one.annotation for one in ast.walk(function.args) if isinstance(one, ast.arg)]
    signature = " ".join(ast.unparse(one) for one in (*annotations, function.returns) if one)
    own = ast.get_docstring(function) or ""
    found.public += 1
    found.documented += bool(own)
    if ARRAY.search(signature):
        said = "\n".join([signature, own, *(ast.get_docstring(one) or "" for one in owners)])
        found.with_arrays += 1
        found.shapes += bool(SHAPE.search(said))
        found.units += bool(UNIT.search(said))


def count_lines(text: str, tree: ast.Module, found: Numbers) -> None:
    """Add a module's lines of comments, of docstrings, and of code."""
    strings = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    ]
    inside = {n for node in strings for n in range(node.lineno, (node.end_lineno or 0) + 1)}
    comments, code = set(), set()
    skipped = (tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            comments.add(token.start[0])
        elif token.type not in skipped:
            code.update(range(token.start[0], token.end[0] + 1))
    found.comments += len(comments)
    found.docstrings += len(inside)
    found.code += len(code - inside)


def row(found: Numbers) -> dict[str, str]:
    """The table's entries of one package."""
    modules, sizes = list(found.modules.values()), list(found.functions.values())

    def share(part: int, whole: int) -> str:
        return f"{100 * part / max(whole, 1):.0f}%"

    return {
        "modules": f"{len(modules)}",
        "lines of code": f"{found.code}",
        "lines a module, median and most": f"{median(modules):.0f}, {max(modules)}",
        f"modules over {MODULE} lines": share(sum(n > MODULE for n in modules), len(modules)),
        "lines a function, median and most": f"{median(sizes):.0f}, {max(sizes)}",
        f"functions over {FUNCTION} lines": share(sum(n > FUNCTION for n in sizes), len(sizes)),
        "public functions": f"{found.public}",
        "with a docstring": share(found.documented, found.public),
        "with arrays: that state shapes": share(found.shapes, found.with_arrays),
        "with arrays: that state units": share(found.units, found.with_arrays),
        "comment lines per 100 of code": f"{100 * found.comments / found.code:.0f}",
        "docstring lines per 100 of code": f"{100 * found.docstrings / found.code:.0f}",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--long", action="store_true", help="list long modules and functions")
    chosen = parser.parse_args()
    found = {folder.name: measure(folder) for folder in chosen.folders}
    rows = {name: row(numbers) for name, numbers in found.items()}
    print("|" + "|".join(["", *rows]) + "|")
    print("|" + "---|" * (1 + len(rows)))
    for label in next(iter(rows.values())):
        print("|" + "|".join([label, *(each[label] for each in rows.values())]) + "|")
    if chosen.long:
        for name, numbers in found.items():
            for sizes, limit in ((numbers.modules, MODULE), (numbers.functions, FUNCTION)):
                for place, size in sorted(sizes.items(), key=lambda item: -item[1]):
                    if size > limit:
                        print(f"{size:5} {name}/{place}")


if __name__ == "__main__":
    main()
