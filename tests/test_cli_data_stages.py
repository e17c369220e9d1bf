"""`render` and `label-sdf` as a user runs them: files, resumption, shards, processes, SIGKILL."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import trimesh
from conftest import run_cli

from pointsdf_cli.geometry.frames import apply_transform, invert_transform
from pointsdf_cli.io.labels import read_labels
from pointsdf_cli.io.views import read_views

RENDER = ("render", "--views", 12, "--jobs", 1, "--quiet")
LABEL = ("label-sdf", "--points", 2000, "--jobs", 1, "--quiet")
KILLS = int(os.environ.get("RGRASP_KILLS", "6"))


def contents(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """Every dataset of every artifact below a folder."""
    from pointsdf_cli.io.describe import describe
    from pointsdf_cli.io.hdf5 import open_hdf5

    found = {}
    for path in sorted(folder.rglob("*.h5")):
        with open_hdf5(path) as file:
            found[path.relative_to(folder).as_posix()] = {
                name: file[name][()] for name in describe(path)["datasets"]
            }
    return found


def assert_equal_contents(one: Path, other: Path) -> None:
    first, second = contents(one), contents(other)
    assert first.keys() == second.keys()
    assert first
    for name, datasets in first.items():
        for key, array in datasets.items():
            np.testing.assert_array_equal(array, second[name][key], err_msg=f"{name} {key}")


@pytest.fixture
def views(mesh_folder: Path, tmp_path: Path) -> Path:
    assert run_cli(*RENDER, "--meshes", mesh_folder, "--out", tmp_path / "views").code == 0
    return tmp_path / "views"


def test_labels_are_the_distances_to_the_surface_that_the_views_show(
    views: Path, mesh_folder: Path, tmp_path: Path
) -> None:
    result = run_cli(
        *LABEL, "--views", views, "--meshes", mesh_folder, "--out", tmp_path / "labels", "--json"
    )
    assert result.code == 0
    values = json.loads(result.out)
    assert values["made"] == 3
    assert 0.1 < values["inside_fraction"] < 0.6
    labels = read_labels(tmp_path / "labels" / "ball.h5")
    expected = np.linalg.norm(labels.points, axis=1) - 0.05
    # The ball is a polyhedron of 1280 faces: its sagitta is r(1 − cos(edge/2r)) ≈ 0.4 mm.
    assert np.abs(labels.sdf - expected).max() < 5e-4
    read = read_views(views / "ball.h5")
    assert read.mesh_hash == labels.mesh_hash
    seen = apply_transform(invert_transform(read.T_camera_object[0]), read.cloud[0])
    # Noise of 1 mm along z moves points off the sphere by about as much.
    assert abs(np.linalg.norm(seen, axis=1).mean() - 0.05) < 5e-4


def test_depth_images_are_stored_when_asked_for(mesh_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "views"
    run_cli(
        *RENDER, "--meshes", mesh_folder / "box.ply", "--out", out, "--keep-depth", "--views", 2
    )
    views = read_views(out / "box.h5", with_depth=True)
    assert views.depth is not None
    assert views.depth.shape == (2, 480, 640)
    # Each cloud point is a pixel of its image.
    pixels = views.cloud[0] @ views.K.T
    u, v = np.rint(pixels[:, :2] / pixels[:, 2:]).astype(int).T
    np.testing.assert_allclose(views.depth[0][v, u], views.cloud[0][:, 2], atol=1e-6)


def test_two_processes_make_what_one_makes(views: Path, mesh_folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "two"
    run_cli(*RENDER, "--meshes", mesh_folder, "--out", other, "--jobs", 2)
    assert_equal_contents(views, other)
    for jobs in (1, 2):
        run_cli(
            *LABEL, "--views", views, "--meshes", mesh_folder, "--out", tmp_path / f"l{jobs}",
            "--jobs", jobs,
        )  # fmt: skip
    assert_equal_contents(tmp_path / "l1", tmp_path / "l2")


def test_shards_together_are_the_whole(views: Path, mesh_folder: Path, tmp_path: Path) -> None:
    for shard in ("0/2", "1/2"):
        run_cli(*RENDER, "--meshes", mesh_folder, "--out", tmp_path / "s", "--shard", shard)
        run_cli(
            *LABEL, "--views", views, "--meshes", mesh_folder, "--out", tmp_path / "sl",
            "--shard", shard,
        )  # fmt: skip
    assert_equal_contents(views, tmp_path / "s")
    run_cli(*LABEL, "--views", views, "--meshes", mesh_folder, "--out", tmp_path / "l")
    assert_equal_contents(tmp_path / "l", tmp_path / "sl")


def test_another_seed_makes_other_views(views: Path, mesh_folder: Path, tmp_path: Path) -> None:
    run_cli(*RENDER, "--meshes", mesh_folder, "--out", tmp_path / "other", "--seed", 1)
    one, other = contents(views)["ball.h5"], contents(tmp_path / "other")["ball.h5"]
    assert not np.array_equal(one["cloud"], other["cloud"])


def test_a_second_run_keeps_what_is_there_and_force_makes_it_anew(
    views: Path, mesh_folder: Path
) -> None:
    before = {p: p.stat().st_mtime_ns for p in views.glob("*.h5")}
    again = run_cli(*RENDER, "--meshes", mesh_folder, "--out", views, "--json")
    assert json.loads(again.out)["kept"] == 3
    assert {p: p.stat().st_mtime_ns for p in views.glob("*.h5")} == before
    assert run_cli(*RENDER, "--meshes", mesh_folder, "--out", views, "--force").code == 0
    assert all(p.stat().st_mtime_ns > before[p] for p in before)


def test_one_bad_mesh_does_not_stop_the_others(mesh_folder: Path, tmp_path: Path) -> None:
    (mesh_folder / "bad.obj").write_text("v 0 0 nonsense\nf 1 2 3\n")
    result = run_cli(*RENDER, "--meshes", mesh_folder, "--out", tmp_path / "v")
    assert result.code == 2
    assert "bad.obj" in result.err
    assert len(list((tmp_path / "v").glob("*.h5"))) == 3
    skipped = run_cli(*RENDER, "--meshes", mesh_folder, "--out", tmp_path / "v", "--skip-bad")
    assert skipped.code == 0


def test_a_missing_mesh_stops_its_own_labels_only(
    views: Path, mesh_folder: Path, tmp_path: Path
) -> None:
    meshes = sorted(mesh_folder.iterdir())
    meshes[0].unlink()
    options = (*LABEL, "--views", views, "--meshes", mesh_folder, "--out", tmp_path / "l")
    result = run_cli(*options)
    assert result.code == 2
    assert f"no mesh {meshes[0].stem}.*" in result.err
    assert len(list((tmp_path / "l").glob("*.h5"))) == len(meshes) - 1
    assert run_cli(*options, "--skip-bad").code == 0
    # Two formats of one mesh: --pattern tells which was rendered.
    other = meshes[1].with_suffix(".off")
    trimesh.creation.box((0.1, 0.1, 0.1)).export(other)
    assert "two meshes of one name" in run_cli(*options).err
    assert run_cli(*options, "--pattern", "*[!f]", "--skip-bad").code == 0


def test_labels_of_another_mesh_are_refused(views: Path, mesh_folder: Path, tmp_path: Path) -> None:
    trimesh.creation.box((0.05, 0.05, 0.05)).export(mesh_folder / "ball.ply")
    result = run_cli(*LABEL, "--views", views, "--meshes", mesh_folder, "--out", tmp_path / "l")
    assert result.code == 2
    assert "not the mesh that its views were rendered from" in result.err
    assert not (tmp_path / "l" / "ball.h5").exists()


def test_killed_at_random_moments_a_stage_resumes_to_the_same_datasets(tmp_path: Path) -> None:
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    for k in range(12):
        box = trimesh.creation.box(np.array([0.05, 0.07, 0.09]) * (1 + 0.02 * k))
        box.subdivide().subdivide().export(meshes / f"box{k:02d}.ply")
    render = ["--meshes", meshes, "--views", 60, "--jobs", 2, "--quiet"]
    label = ["--meshes", meshes, "--points", 30_000, "--jobs", 2, "--quiet"]
    assert run_cli("render", *render, "--out", tmp_path / "views").code == 0
    whole = ["--views", tmp_path / "views", "--out", tmp_path / "labels"]
    assert run_cli("label-sdf", *label, *whole).code == 0

    moments = random.Random(0)
    stages = {
        "views2": ["render", *render, "--out", tmp_path / "views2"],
        "labels2": [
            "label-sdf",
            *label,
            "--views",
            tmp_path / "views",
            "--out",
            tmp_path / "labels2",
        ],
    }
    for name, command in stages.items():
        for _ in range(KILLS // 2):
            process = subprocess.Popen(
                [sys.executable, "-m", "pointsdf_cli.cli.main", *map(str, command)],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            time.sleep(moments.uniform(0.3, 4.0))
            process.send_signal(signal.SIGKILL)
            process.wait()
        assert run_cli(*command).code == 0
        assert_equal_contents(tmp_path / name[:-1], tmp_path / name)
        assert all(path.suffix == ".h5" for path in (tmp_path / name).iterdir())


def test_views_of_a_mesh_that_has_changed_are_not_kept(views: Path, mesh_folder: Path) -> None:
    trimesh.creation.box((0.05, 0.05, 0.05)).export(mesh_folder / "ball.ply")
    result = run_cli(*RENDER, "--meshes", mesh_folder, "--out", views)
    assert result.code == 2
    assert "another version" in result.err
    assert "--force" in result.err


def test_labels_in_another_unit_are_not_kept(tmp_path: Path) -> None:
    meshes, views, labels = tmp_path / "meshes", tmp_path / "views", tmp_path / "labels"
    meshes.mkdir()
    trimesh.creation.box((8.0, 6.0, 4.0)).export(meshes / "box.ply")
    places = ("--meshes", meshes, "--out", views)
    made = run_cli(*RENDER, *places, "--unit", "cm")
    assert made.code == 0, made.err
    label = (*LABEL, "--meshes", meshes, "--views", views, "--out", labels)
    assert run_cli(*label).code == 0
    assert "1 there already" in run_cli(*label).out
    assert run_cli(*RENDER, *places, "--unit", "inch", "--force").code == 0
    refused = run_cli(*label)
    assert refused.code == 2
    assert "unit: cm there, inch now" in refused.err
    assert run_cli(*label, "--force").code == 0
    across = np.ptp(read_labels(labels / "box.h5").points, axis=0).max()
    assert across > 8 * 0.0254
    inside = run_cli(*label[:-1], views / "labels")
    assert inside.code == 2
    assert "lies within" in inside.err
    # The report finds the mesh in its unit without being told.
    page = run_cli("report", tmp_path, "--out", tmp_path / "page.html")
    assert page.code == 0, page.err
