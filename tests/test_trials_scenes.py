"""Scenes of trials: what stands in a shop stands on the table, where and how the protocol says."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.simulation.world import World
from pointsdf_cli.trials.protocol import METHODS, Contender, choose_objects, make_trials
from pointsdf_cli.trials.scenes import SceneConfig, load_object, place_camera, place_object

pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    made = World(load_robot())
    yield made
    made.close()


@pytest.mark.parametrize(("name", "height"), [("pringles", 0.247), ("max_gel", 0.185)])
def test_what_can_stand_stands_in_every_yaw(
    world: World, name: str, height: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RGRASP_CACHE", str(tmp_path))
    trials = make_trials(choose_objects(None, name), [Contender(METHODS[0])])
    item = load_object(trials[0].object)
    yaws, axes = [], []
    for trial in trials:
        pose, yaw = place_object(world, item, trial, SceneConfig())
        placed = apply_transform(pose, item.mesh.vertices)
        assert placed[:, 2].max() == pytest.approx(height, abs=0.003)
        assert placed[:, 2].min() == pytest.approx(0.0, abs=0.003)
        middle = (placed.min(axis=0) + placed.max(axis=0))[:2] / 2
        np.testing.assert_allclose(middle, [0.6, 0.0], atol=0.08)
        camera = place_camera(item, pose, trial, SceneConfig())
        # It looks at the object, from beyond it.
        offset = np.array([*middle, SceneConfig().look_height]) - camera[:3, 3]
        assert camera[:3, 2] @ offset / np.linalg.norm(offset) == pytest.approx(1.0, abs=1e-9)
        assert np.linalg.norm(offset[:2]) == pytest.approx(SceneConfig().camera_distance)
        yaws.append(yaw)
        axes.append(np.arctan2(pose[1, 0], pose[0, 0]))
    # High and low share a yaw; the three yaws are a third of a turn apart, and the mesh turns so.
    assert yaws[0::2] == yaws[1::2]
    np.testing.assert_allclose(np.mod(np.diff(yaws[0::2]), 2 * np.pi), 2 * np.pi / 3)
    np.testing.assert_allclose(np.mod(np.diff(axes[0::2]), 2 * np.pi), 2 * np.pi / 3, atol=1e-3)
