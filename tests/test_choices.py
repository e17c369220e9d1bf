"""Fixed sets of values: the names in the types are those of the tables, and others are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, get_args

import pytest
from typer.main import get_command

from pointsdf_cli import choices
from pointsdf_cli.camera.charuco import BITS, SIZES
from pointsdf_cli.camera.sensor_presets import SENSORS
from pointsdf_cli.cli.app import app_of
from pointsdf_cli.io.meshes import UNITS
from pointsdf_cli.training.gs_variants import ARCHITECTURES
from pointsdf_cli.training.sdf_table import PUBLISHED


def test_types_name_what_the_tables_hold() -> None:
    assert get_args(choices.Unit) == tuple(UNITS)
    assert get_args(choices.Sensor) == tuple(SENSORS)
    assert get_args(choices.Encoder) == tuple(ARCHITECTURES)
    assert get_args(choices.Dictionary) == tuple(f"{b}X{b}_{s}" for b in BITS for s in SIZES)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "plan a --method guess",
            "--method: no method 'guess'\n  allowed: reconstruction, partial",
        ),
        ("mesh a --format DOC", "--format: no format 'DOC'\n  allowed: ply, obj, stl, glb"),
        ("calibrate a --pose-unit x", "--pose-unit: no pose unit 'x'\n  allowed: m, cm, mm, inch"),
        ("objects fetch shapes", "COLLECTION: no collection 'shapes'\n  allowed: ycb"),
    ],
)
def test_another_value_is_one_message(cli: Callable[..., Any], words: str, message: str) -> None:
    told = cli(*words.split())
    assert (told.code, told.out) == (2, "")
    assert told.err.startswith(f"rgrasp: {message}")


def test_completion_offers_the_values() -> None:
    commands: Any = get_command(app_of())
    option = next(p for p in commands.commands["eval-sdf"].params if p.name == "beside")
    offered = option.shell_complete(commands.make_context("rgrasp", ["info"]), "")
    assert {item.value for item in offered} == set(PUBLISHED)
