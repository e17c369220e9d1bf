"""Bodies in front of an object, against lines of sight that are computed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pointsdf_cli.camera import table_scene

POLE = np.array([[x, y, z] for x in (-0.01, 0.01) for y in (-0.01, 0.01) for z in (0.0, 0.2)])
"""Corners of a pole, 0.2 m high, on the table's origin [m]."""


@pytest.mark.parametrize("seed", range(12))
def test_the_body_reaches_up_to_the_line_of_sight(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table_scene, "HIDING_HEIGHT", (0.5, 0.5))
    eye, middle, reach = np.array([0.0, -1.0, 0.5]), np.zeros(2), 0.015
    body = table_scene._hiding_body(
        POLE, eye, middle, reach, -np.pi / 2, np.random.default_rng(seed)
    )
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    away = np.linalg.norm((low + high)[:2] / 2)
    # From 0.1 m on the pole, 1 m away, to the eye 0.4 m higher.
    assert high[2] == pytest.approx(0.1 + 0.4 * away, abs=1e-4)
    assert low[2] == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(body.vertices[:, :2], axis=1).min() > reach  # clear of the pole
    assert (low + high)[1] < 0  # on the camera's side
