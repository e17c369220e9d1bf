"""`rgrasp segment`: what stands on the table of the bundled cloud, numbered and drawn."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

REPOSITORY = Path(__file__).resolve().parents[1]
TABLE = REPOSITORY / "assets" / "clouds" / "table.ply"


def test_three_things_stand_on_the_bundled_table(cli: Any, tmp_path: Path) -> None:
    picture = tmp_path / "scene.png"
    result = cli("segment", str(TABLE), "--picture", str(picture), "--json")
    assert result.code == 0, result.err
    things = json.loads(result.out)["objects"]
    assert len(things) == 3
    centres = np.array([thing["centre"] for thing in things])
    assert (centres[:, 2] > 0).all()
    assert (centres[:, 2] < 0.3).all()
    assert np.asarray(Image.open(picture)).std() > 1


def test_a_number_that_is_not_there_is_refused_with_those_that_are(
    cli: Any, tmp_path: Path
) -> None:
    wrong = cli("mesh", str(TABLE), "--segment", "auto", "--target", "9", "--out", "m.ply")
    assert wrong.code == 2
    assert "no object 9" in wrong.err
    assert "3 at 0.6" in wrong.err
