"""`rgrasp trial` as a user meets it: a table, a report, the same again, resumed after a loss."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from pointsdf_cli.io.trials import read_trial, read_trials
from pointsdf_cli.trials.protocol import ABLATIONS, planner_variants

pytest.importorskip("pybullet")


@pytest.fixture
def meshes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("RGRASP_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "meshes"
    folder.mkdir()
    trimesh.creation.cylinder(0.03, 0.15).export(folder / "can.ply")
    return folder


def test_trials_resume_and_do_not_depend_on_jobs(
    cli: Callable[..., Any], meshes: Path, tmp_path: Path
) -> None:
    out = tmp_path / "trials"
    run = (
        *("trial", "--meshes", meshes, "--method", "partial-view", "--yaws", 1),
        *("--pictures", 1, "--seed", 4, "--hold", 0.2, "--push", 0),
    )
    first = cli(*run, "--out", out, "--jobs", 1, "--json", "--record", 1)
    assert first.code == 0, first.err
    result = json.loads(first.out)
    assert result["trials"] == 2
    rows = read_trials(out / "trials.h5")
    assert [(row.object, row.camera, row.method) for row in rows] == [
        ("can", "high", "partial-view"),
        ("can", "low", "partial-view"),
    ]
    assert result["held"]["partial-view"] == np.mean([row.held for row in rows])
    assert result["unshaken"] == {}
    assert (out / "report.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    assert "partial-view" in (out / "report.md").read_text(encoding="utf-8")

    # A trial that was lost is run again and ends the same; the other is kept as it is.
    files = sorted((out / "trials").glob("*.h5"))
    kept, lost = files[0].read_bytes(), read_trial(files[1])
    files[1].unlink()
    assert cli(*run, "--out", out, "--jobs", 1, "--quiet").code == 0
    assert files[0].read_bytes() == kept
    same(read_trial(files[1]), lost)

    # In processes of their own, which have planned nothing before, unlike this one.
    other = tmp_path / "parallel"
    assert cli(*run, "--out", other, "--jobs", 2, "--quiet").code == 0
    for path in files:
        same(read_trial(other / "trials" / path.name), read_trial(path))

    changed = (*run, "--out", out, "--jobs", 1, "--cameras", "high", "--shake", 2)
    refused = cli(*changed)
    assert refused.code == 2
    assert "other options" in refused.err
    replaced = cli(*changed, "--force")
    assert replaced.code == 0
    assert f"1 trials of other options in {out / 'trials'} are not in the tables" in replaced.out


def same(one: Any, two: Any) -> None:
    """Equal to the bit but for the time that planning took."""
    for field in vars(one[0]):
        if not field.startswith("planning_"):
            np.testing.assert_equal(getattr(one[0], field), getattr(two[0], field))
    for field in vars(one[1]):
        np.testing.assert_array_equal(getattr(one[1], field), getattr(two[1], field))


def test_all_ablations_are_one_word() -> None:
    named = planner_variants("reconstruction", ["all", "checkpoint=paper"])
    assert [one.ablation for one in named] == ["", *ABLATIONS, "checkpoint=paper"]
    assert {one.method for one in named} == {"reconstruction"}


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--meshes", "nowhere"), "no such folder"),
        (("--method", "magic"), "no method"),
        (("--ablation", "orakel"), "no ablation"),
        (("--cameras", "middle"), "no camera"),
        (("--objects", "anvil"), "no object"),
        (("--yaws", 0), "yaws"),
        (("--seed", -1), "seed"),
        (("--margin", 1), "--margin"),
        (("--record", -1), "--record"),
        (("--hold", -1), "--hold"),
        (("--push", "nan"), "--push"),
        (("--checkpoint", "nowhere"), "nowhere"),
        (("--solver", "newton"), "no solver"),
    ],
)
def test_mistakes_are_one_message(
    cli: Callable[..., Any], tmp_path: Path, options: tuple[object, ...], says: str
) -> None:
    result = cli("trial", "--out", tmp_path / "trials", *options, "--jobs", 1)
    assert result.code == 2
    assert says in result.err
    assert "Traceback" not in result.err
