"""The protocol: how many trials, what pairs share, which objects a folder stands for."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pointsdf_cli.errors import InputError
from pointsdf_cli.objects.stand_ins import STAND_INS, make_stand_in
from pointsdf_cli.trials.protocol import (
    CAMERAS,
    METHODS,
    PlannerVariant,
    choose_objects,
    make_trials,
)

BOTH = [PlannerVariant(method) for method in METHODS]


def test_the_paper_makes_96_trials() -> None:
    trials = make_trials(choose_objects(None), BOTH)
    assert len(trials) == len({trial.name for trial in trials}) == 96
    counts = Counter((trial.object.name, trial.camera, trial.variant.method) for trial in trials)
    assert set(counts.values()) == {3}
    assert CAMERAS["high"] - CAMERAS["low"] == pytest.approx(0.45)


def test_contenders_of_a_pair_meet_the_same_randomness_and_others_do_not() -> None:
    trials = make_trials(choose_objects(None), BOTH, repeats=2, seed=3)
    draws: dict[str, set[float]] = {}
    for trial in trials:
        draws.setdefault(trial.pair_name, set()).add(trial.rng("view").random())
    assert all(len(values) == 1 for values in draws.values())
    assert len({value for values in draws.values() for value in values}) == len(draws) == 96
    # The object stands in one place for both cameras.
    scenes = {(t.scene_name, t.rng("scene").random(), t.rng("pose").random()) for t in trials}
    assert len(scenes) == 48


def test_randomness_does_not_depend_on_what_else_is_tried() -> None:
    alone = make_trials(choose_objects(None, "lego"), BOTH[:1], seed=1)
    among = {trial.name: trial for trial in make_trials(choose_objects(None), BOTH, seed=1)}
    for trial in alone:
        assert trial.rng("view").random() == among[trial.name].rng("view").random()


def folder_of(path: Path, *names: str) -> Path:
    for name in names:
        trimesh.creation.box((0.1, 0.1, 0.1)).export(path / f"{name}.ply")
    return path


def test_a_ycb_folder_gives_its_objects_and_stand_ins_for_the_rest(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "006_mustard_bottle", "001_chips_can", "011_banana")
    chosen = {item.name: item.mesh for item in choose_objects(folder)}
    assert list(chosen) == list(STAND_INS)
    assert chosen["mustard"] == folder / "006_mustard_bottle.ply"
    assert chosen["pringles"] == folder / "001_chips_can.ply"
    assert chosen["juice_box"] is None
    assert [item.name for item in choose_objects(folder, "others")] == ["011_banana"]
    assert len(choose_objects(folder, "all")) == 3
    assert [i.name for i in choose_objects(folder, "lego,011_banana")] == ["lego", "011_banana"]
    (folder / "other").mkdir()
    (folder / "other" / "011_banana.ply").write_bytes(b"")
    assert [item.name for item in choose_objects(folder, "lego")] == ["lego"]
    with pytest.raises(InputError, match="two meshes are called 011_banana"):
        choose_objects(folder, "lego,011_banana")


def test_a_mesh_of_a_papers_name_is_that_mesh(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "mustard", "006_mustard_bottle")
    (mine,) = choose_objects(folder, "mustard")
    assert (mine.mesh, mine.upright) == (folder / "mustard.ply", False)
    (theirs,) = choose_objects(None, "mustard")
    assert (theirs.mesh, theirs.upright) == (None, True)


def test_any_other_folder_gives_all_its_meshes(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "cup", "box", "001_kettle", "073_shoe")
    names = ["001_kettle", "073_shoe", "box", "cup"]  # numbered, but not YCB's
    assert [item.name for item in choose_objects(folder)] == names


def test_mistakes_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        choose_objects(tmp_path / "none")
    with pytest.raises(InputError, match="no object 'mustrad'"):
        choose_objects(None, "mustrad")
    with pytest.raises(InputError, match="needs a folder"):
        choose_objects(None, "others")
    with pytest.raises(InputError, match="no camera"):
        make_trials(choose_objects(None), BOTH, cameras=("middle",))
    with pytest.raises(InputError, match="a camera is given twice"):
        make_trials(choose_objects(None), BOTH, cameras=("high", "high"))
    with pytest.raises(InputError, match="an object twice"):
        choose_objects(None, "lego,lego")
    with pytest.raises(InputError, match="yaws"):
        make_trials(choose_objects(None), BOTH, yaws=0)
    with pytest.raises(InputError, match="no ablation 'orakel'"):
        PlannerVariant("reconstruction", "orakel")
    with pytest.raises(InputError, match="each once"):
        make_trials(choose_objects(None), BOTH[:1] * 2)


@pytest.mark.parametrize("name", STAND_INS)
def test_stand_ins_are_closed_and_of_the_real_size(name: str) -> None:
    vertices, faces = make_stand_in(name)
    solid = trimesh.Trimesh(vertices, faces)
    assert solid.is_watertight
    assert solid.volume > 0
    np.testing.assert_allclose(solid.extents, STAND_INS[name].size, rtol=1e-4)


def test_a_stand_in_that_nobody_knows() -> None:
    with pytest.raises(InputError, match="no stand-in"):
        make_stand_in("anvil")
