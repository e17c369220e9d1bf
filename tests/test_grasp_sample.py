"""The grasps that are kept for tests: read, made of today's object, and carried out again.

    rgrasp objects make --out m --count 2 --seed 0 --families can,carton
    rgrasp collect-grasps --meshes m --out tests/data/grasps --count 8 --seed 1 --no-pictures

(The carton is too wide for the hand.)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pointsdf_cli.io.grasps import CAUSES, HELD, read_grasps
from pointsdf_cli.io.meshes import LoadedMesh, load_mesh
from pointsdf_cli.objects.store import make_objects
from pointsdf_cli.robot.description import load_robot
from pointsdf_cli.training.gs_data import read_grasp_data

SAMPLE = Path(__file__).parent / "data" / "grasps"


@pytest.fixture(scope="module")
def can(tmp_path_factory: pytest.TempPathFactory) -> LoadedMesh:
    folder = tmp_path_factory.mktemp("objects")
    make_objects(folder, 1, seed=0, families=["can", "carton"])
    return load_mesh(folder / "00000_can.ply")


def test_it_is_read_as_what_it_was_written(can: LoadedMesh) -> None:
    grasps, meta = read_grasps(SAMPLE / "00000_can.h5")
    assert (len(grasps), int(grasps.executed.sum())) == (15, 8)
    assert int((grasps.label == HELD).sum()) == 6
    assert meta.mesh_hash == can.sha256
    assert {CAUSES[cause] for cause in grasps.cause[grasps.label == HELD]} == {"held"}
    assert (grasps.lift_height[grasps.label == HELD] > 0.105).all()
    # They were not pushed.
    assert (grasps.unshaken == -1).all()
    # Success networks learn from it: robot, palm frame and joints are those of the bundled robot.
    data = read_grasp_data(SAMPLE, load_robot())
    assert data.names == ["00000_can"]


def test_carried_out_again_it_ends_the_same(
    can: LoadedMesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pybullet")
    from pointsdf_cli.simulation.attempter import Attempter
    from pointsdf_cli.simulation.sim_object import prepare_object

    monkeypatch.setenv("RGRASP_CACHE", str(tmp_path))
    grasps, _ = read_grasps(SAMPLE / "00000_can.h5")
    attempter, item = Attempter(load_robot(), seed=1), prepare_object(can)
    try:
        rows = np.flatnonzero(grasps.executed)
        again = [attempter.replay(item, grasps, int(row)).held for row in rows]
    finally:
        attempter.close()
    # On another processor the last digits differ, and one in twenty labels hangs on those.
    assert (np.array(again) == (grasps.label[rows] == HELD)).sum() >= len(rows) - 1
