"""The floors: a module imports only from the floors below, and nothing imports in a ring."""

from __future__ import annotations

import ast
import sys
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "pointsdf_cli"
FLOORS = [
    {"errors", "deferred", "preload", "__init__"},
    {"assets", "choices"},
    {"geometry"},
    {"io"},
    {"camera", "objects"},
    {"robot"},
    {"models"},
    {"training", "viz"},
    {"planning", "simulation"},
    {"trials", "doctor"},
    {"service"},
    {"cli"},
]
LEVEL = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}
# Rooms of one floor keep apart, but for these: what trains and plans may draw what it did, and
# reading assets is as low as naming them.
SAME_FLOOR_ALLOWED = {("camera", "objects"), ("training", "viz"), ("planning", "simulation")}
TERMINAL = {"typer", "rich", "click"}


def modules() -> dict[str, Path]:
    """All but the package's own `__init__`, which names functions of every floor and imports none
    before they are asked for."""
    return {
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts): path
        for path in PACKAGE.rglob("*.py")
        if path != PACKAGE / "__init__.py"
    }


def imports(path: Path) -> set[str]:
    """Every module that `path` imports, wherever in the file, under its full name."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module)
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def room(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def test_every_room_has_a_floor() -> None:
    assert {room(module) for module in modules()} <= set(LEVEL)


def test_imports_run_downwards_only() -> None:
    wrong = []
    for module, path in modules().items():
        for name in imports(path):
            if name.split(".")[0] != "pointsdf_cli" or room(name) not in LEVEL:
                continue
            here, there = room(module), room(name)
            same = here == there or tuple(sorted((here, there))) in SAME_FLOOR_ALLOWED
            if LEVEL[there] > LEVEL[here] or (LEVEL[there] == LEVEL[here] and not same):
                wrong.append(f"{module} ({here}) imports {name} ({there})")
    assert not wrong, "\n".join(wrong)


def test_planning_draws_nothing() -> None:
    wrong = [
        f"{module} imports {name}"
        for module, path in modules().items()
        for name in imports(path)
        if room(module) == "planning" and room(name) == "viz" and name in modules()
    ]
    assert not wrong, "\n".join(wrong)


def test_no_module_imports_itself_through_others() -> None:
    known = modules()
    graph = {
        module: {n for n in imports(path) if n in known and n != module}
        for module, path in known.items()
    }
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(f"import cycle: {' → '.join(error.args[1])}")


def test_only_the_cli_floor_knows_the_terminal() -> None:
    wrong = [
        f"{module} imports {name}"
        for module, path in modules().items()
        for name in imports(path)
        if name.split(".")[0] in TERMINAL and room(module) != "cli"
    ]
    assert not wrong, "\n".join(wrong)


def test_every_third_party_import_is_a_declared_dependency() -> None:
    declared = (PACKAGE.parent / "pyproject.toml").read_text(encoding="utf-8").lower()
    distribution = {
        "yaml": "pyyaml",
        "cv2": "opencv-python-headless",
        "igl": "libigl",
        "sklearn": "scikit-learn",
        "skimage": "scikit-image",
        "pil": "pillow",
        "pybullet_data": "pybullet",
        "fastapi_offline": "fastapi-offline",
        "pytorch_kinematics": "pytorch-kinematics",
    }
    missing = set()
    for path in modules().values():
        for name in imports(path):
            top = name.split(".")[0]
            if top == "pointsdf_cli" or top in sys.stdlib_module_names:
                continue
            if f'"{distribution.get(top.lower(), top.lower())}' not in declared.replace("_", "-"):
                missing.add(top)
    assert not missing
