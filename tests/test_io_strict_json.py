"""JSON for other programs: null where there is no number, everything else as it was."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pointsdf_cli.io.strict_json import to_json


def strictly(text: str) -> object:
    """Parsed as a browser would: NaN and Infinity are refused."""

    def refuse(constant: str) -> object:
        raise ValueError(constant)

    return json.loads(text, parse_constant=refuse)


def test_what_is_no_number_is_null() -> None:
    value = {
        "a": float("nan"),
        "b": [1.5, -np.inf, (np.float32("nan"), 2)],
        "c": np.array([[1.0, np.nan]]),
        "d": {"e": None, "f": True},
    }
    assert strictly(to_json(value)) == {
        "a": None,
        "b": [1.5, None, [None, 2]],
        "c": [[1.0, None]],
        "d": {"e": None, "f": True},
    }


def test_paths_scalars_and_letters_are_kept() -> None:
    value = {"out": Path("a/b"), "n": np.int64(3), 4: "Größe", "exact": 0.1}
    assert strictly(to_json(value)) == {"out": "a/b", "n": 3, "4": "Größe", "exact": 0.1}
    assert "Größe" in to_json(value)


def test_anything_else_is_an_error_of_the_program() -> None:
    with pytest.raises(TypeError):
        to_json({"a": object()})
