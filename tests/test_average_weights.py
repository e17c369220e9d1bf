"""The mean of two checkpoints, of which the second reads more."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.checkpoints import write_checkpoint
from pointsdf_cli.models.reconstruction import Reconstruction
from pointsdf_cli.models.registry import build_model, load_model

average = runpy.run_path(str(Path(__file__).parents[1] / "pipelines" / "average_weights.py"))[
    "average"
]


def write_network(path: Path, seed: int, surroundings: bool) -> Path:
    arguments = {"revolution": True, "box": True, "surroundings": surroundings}
    model = build_model("pointsdf-ray", arguments, seed)
    config = {"architecture": "pointsdf-ray", "model": model.config()}
    write_checkpoint(path, config=config, weights=model.state_dict())
    return path


def distances(path: Path) -> np.ndarray:
    rng = np.random.default_rng(0)
    cloud = rng.normal(size=(1000, 3)) * [0.03, 0.03, 0.01] + [0, 0, 0.8]
    shape = Reconstruction.from_cloud(load_model(path), cloud, np.zeros(3))
    return shape.sdf(rng.uniform(-0.05, 0.05, (50, 3)) + [0, 0, 0.8])


def test_the_ends_are_the_networks_and_the_mean_lies_between(tmp_path: Path) -> None:
    before = write_network(tmp_path / "before", 0, surroundings=False)
    after = write_network(tmp_path / "after", 1, surroundings=True)
    for share, same in ((0.0, before), (1.0, after)):
        average(before, after, tmp_path / f"share{share}", share)
        # Half precision is exact to 2^-11.
        np.testing.assert_allclose(
            distances(tmp_path / f"share{share}"), distances(same), atol=2e-4
        )
    average(before, after, tmp_path / "mean", 0.5)
    weights = [
        load_model(tmp_path / name).state_dict()["leave.weight"].numpy()
        for name in ("before", "after", "mean")
    ]
    np.testing.assert_allclose(weights[2], (weights[0] + weights[1]) / 2, atol=1e-4)
    with pytest.raises(InputError, match="share"):
        average(before, after, tmp_path / "no", 1.5)
