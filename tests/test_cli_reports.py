"""`info`, `doctor`, `report`: what they print and write about real artifacts."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import run_cli
from plan_files import turning_plan_file

from pointsdf_cli.assets import asset_path
from pointsdf_cli.io.views import read_views, write_views
from pointsdf_cli.robot.description import load_robot


def bundled(name: str) -> Path:
    return asset_path(f"weights/{name}")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Views and labels of two meshes, and the meshes, below one folder."""
    import trimesh

    folder = tmp_path_factory.mktemp("data")
    (folder / "meshes").mkdir()
    trimesh.creation.icosphere(subdivisions=3, radius=0.05).export(folder / "meshes" / "ball.ply")
    trimesh.creation.torus(0.04, 0.012).export(folder / "meshes" / "ring.stl")
    meshes, views = folder / "meshes", folder / "views"
    assert run_cli("render", "--meshes", meshes, "--out", views, "--views", 4, "-q").code == 0
    label = ("label-sdf", "--views", views, "--meshes", meshes, "--out", folder / "labels")
    assert run_cli(*label, "--points", 3000, "-q").code == 0
    return folder


def test_info_tells_contents_units_and_provenance(data: Path) -> None:
    result = run_cli("info", data / "views" / "ball.h5", "--json")
    assert result.code == 0
    description = json.loads(result.out)
    assert description["facts"]["schema"] == "views"
    assert description["facts"]["mesh_file"] == "ball.ply"
    assert description["datasets"]["cloud"] == {
        "dtype": "float32",
        "shape": [4, 1000, 3],
        "units": "m",
        "frame": "camera",
    }


def test_info_of_a_mesh_tells_its_size(data: Path) -> None:
    facts = json.loads(run_cli("info", data / "meshes" / "ring.stl", "--json").out)["facts"]
    assert facts["extents [m]"] == pytest.approx([0.104, 0.104, 0.024], abs=1e-3)


def test_info_on_a_terminal_names_every_dataset(data: Path) -> None:
    result = run_cli("info", data / "labels" / "ball.h5")
    assert "points: float32 [3000 × 3] (m, mesh)" in result.out
    assert "sdf: float32 [3000] (m, mesh)" in result.out


def test_doctor_finds_this_installation_well() -> None:
    result = run_cli("doctor", "--json")
    assert result.code == 0, result.out
    checks = json.loads(result.out)
    assert all(check["ok"] for check in checks.values())
    assert "signed distance of a sphere" in checks


def test_doctor_says_what_is_broken_and_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    from pointsdf_cli.geometry.signed_distance import SignedDistance

    # A sign error in the field, the commonest of all.
    right = SignedDistance.__call__
    monkeypatch.setattr(SignedDistance, "__call__", lambda self, points: -right(self, points))
    result = run_cli("doctor")
    assert result.code == 1
    assert "FAIL  signed distance of a sphere" in result.out
    assert "1 checks failed" in result.err


@pytest.mark.parametrize("damage", ["missing", "cut short"])
def test_doctor_opens_every_bundled_network(
    damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pointsdf_cli import assets, doctor

    whole = assets.assets_folder()
    assert {path.name for path in (whole / "weights").iterdir()} == set(doctor.NETWORKS)
    shutil.copytree(whole / "weights", tmp_path / "assets" / "weights")
    shutil.copytree(whole / "robots", tmp_path / "assets" / "robots")
    weights = tmp_path / "assets" / "weights" / "voxelcnn" / "model.safetensors"
    if damage == "missing":
        shutil.rmtree(weights.parent)
    else:
        weights.write_bytes(weights.read_bytes()[:-1000])
    monkeypatch.setattr(assets, "_PACKAGE", tmp_path)
    result = run_cli("doctor")
    assert result.code == 1
    assert "FAIL  assets: " in result.out
    assert "voxelcnn" in result.out


def test_report_is_one_page_with_its_pictures_inside(data: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    result = run_cli("report", data, "--out", page, "--pictures", tmp_path / "png")
    assert result.code == 0, result.err
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 2
    assert "http" not in text.replace("http://www.w3.org", "")
    assert (tmp_path / "png" / "views.png").stat().st_size > 10_000
    assert (tmp_path / "png" / "signed_distance.png").stat().st_size > 10_000


def test_a_report_is_not_overwritten_unasked(data: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text("mine")
    result = run_cli("report", data, "--out", page)
    assert result.code == 2
    assert "--force" in result.err
    assert page.read_text() == "mine"


def test_nothing_is_written_where_one_picture_is_there(data: Path, tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    (pictures / "signed_distance.png").write_bytes(b"mine")
    page = tmp_path / "page.html"
    result = run_cli("report", data, "--out", page, "--pictures", pictures)
    assert result.code == 2
    assert [path.name for path in tmp_path.iterdir()] == ["pictures"]
    assert [path.name for path in pictures.iterdir()] == ["signed_distance.png"]


@pytest.mark.parametrize("folder", ["missing", "empty"])
def test_a_report_on_nothing_is_an_input_error(folder: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    result = run_cli("report", tmp_path / folder)
    assert result.code == 2
    assert not list((tmp_path / "empty").iterdir())


def test_one_file_of_views_or_labels_has_a_page_with_its_mesh(data: Path, tmp_path: Path) -> None:
    for stage, word in (("views", "Views"), ("labels", "Signed distances")):
        page = tmp_path / f"{stage}.html"
        result = run_cli("report", data / stage / "ball.h5", "--out", page)
        assert result.code == 0, result.err
        text = page.read_text()
        assert f"<h2>{word}</h2>" in text
        assert text.count("data:image/png;base64,") == 1
        assert "ring" not in text


@pytest.mark.parametrize("stage", ["views", "labels"])
def test_a_folder_of_one_stage_finds_the_meshes_beside_it(
    stage: str, data: Path, tmp_path: Path
) -> None:
    page, pictures = tmp_path / "page.html", tmp_path / "png"
    result = run_cli("report", data / stage, "--out", page, "--pictures", pictures)
    assert result.code == 0, result.err
    assert page.read_text().count("data:image/png;base64,") == 1
    assert len(list(pictures.iterdir())) == 1


def test_pictures_without_meshes_are_refused(data: Path, tmp_path: Path) -> None:
    shutil.copytree(data / "views", tmp_path / "far" / "views")
    result = run_cli("report", tmp_path / "far" / "views", "--pictures", tmp_path / "png")
    assert result.code == 2
    assert "--meshes" in result.err
    assert not (tmp_path / "far" / "views" / "report.html").exists()


def test_a_page_tells_what_of_a_folder_it_leaves_out(data: Path, tmp_path: Path) -> None:
    shutil.copytree(data / "views", tmp_path / "views")
    turning_plan_file(tmp_path, load_robot())
    result = run_cli("report", tmp_path)
    assert result.code == 0, result.err
    assert "left out: 1 plan" in result.err
    assert (tmp_path / "report.html").is_file()


def test_a_folder_of_plans_is_refused_with_what_to_type(tmp_path: Path) -> None:
    plan = turning_plan_file(tmp_path, load_robot())
    result = run_cli("report", tmp_path)
    assert result.code == 2
    assert "holds plan, of which no common page can be made" in result.err
    assert f"rgrasp report {plan}" in result.err


def moved_views(data: Path, place: Path, shift: float) -> Path:
    """The ball's views with the object moved in each camera [m], in a file with its mesh near."""
    views = read_views(data / "views" / "ball.h5")
    poses = views.T_camera_object.copy()
    poses[:, 0, 3] += shift
    (place / "views").mkdir()
    shutil.copytree(data / "meshes", place / "meshes")
    path = place / "views" / "ball.h5"
    write_views(path, dataclasses.replace(views, T_camera_object=poses), seed=0)
    return path


def test_a_page_on_views_that_do_not_see_their_object(data: Path, tmp_path: Path) -> None:
    path, page = moved_views(data, tmp_path, 50.0), tmp_path / "page.html"
    assert run_cli("report", path, "--out", page).code == 0
    assert "<h2>Views</h2>" in page.read_text()


def test_views_with_a_pose_that_is_none_are_refused(data: Path, tmp_path: Path) -> None:
    result = run_cli("report", moved_views(data, tmp_path, np.inf))
    assert result.code == 2
    assert "not a rigid transform" in result.err


def test_a_checkpoint_has_a_page_with_its_settings_and_its_loss(data: Path, tmp_path: Path) -> None:
    train = ("train-sdf", "--views", data / "views", "--labels", data / "labels", "--steps", 2)
    small = ("--batch-size", 2, "--queries", 8, "--held-out", 0.5, "--threads", 1, "-q")
    assert run_cli(*train, *small, "--out", tmp_path / "ckpt").code == 0
    page = tmp_path / "page.html"
    assert run_cli("report", tmp_path / "ckpt", "--out", page).code == 0
    text = page.read_text()
    assert "<td>training.learning_rate</td>" in text
    assert text.count("data:image/png;base64,") == 1
    described = json.loads(run_cli("info", tmp_path / "ckpt", "--json").out)
    assert described["facts"]["architecture"] == "pointsdf-ray"
    sizes = [np.prod(entry["shape"]) for entry in described["datasets"].values()]
    assert described["facts"]["weights"] == sum(sizes) > 1e6
    # What is shipped has no training state, and no curve.
    assert run_cli("report", bundled("grasp_geometry"), "--out", page, "--force").code == 0
    assert "data:image/png" not in page.read_text()
    assert "<td>calibration.scale</td>" in page.read_text()


def test_clouds_and_meshes_are_described_in_their_unit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (500, 3)) * [40, 20, 10] + [0, 0, 800]
    np.savetxt(tmp_path / "box.xyz", points)
    told = ("info", tmp_path / "box.xyz", "--unit", "mm", "--json")
    facts = json.loads(run_cli(*told).out)["facts"]
    assert facts["points"] == 500
    assert facts["extents [m]"] == pytest.approx([0.08, 0.04, 0.02], abs=1e-3)
    assert facts["frame"] == "camera"
    assert facts["T_world_camera"] is None
    page = tmp_path / "page.html"
    assert run_cli("report", tmp_path / "box.xyz", "--unit", "mm", "--out", page).code == 0
    assert page.read_text().count("data:image/png;base64,") == 1
    assert "[0.07" in page.read_text()


@pytest.mark.parametrize("option", ["--robot", "--meshes"])
def test_an_option_without_use_is_refused(data: Path, tmp_path: Path, option: str) -> None:
    mesh = next(path for path in sorted(data.rglob("*.ply")))
    given = "panda" if option == "--robot" else data
    refused = run_cli("report", mesh, "--out", tmp_path / "page.html", option, given)
    assert refused.code == 2
    assert f"{option}: not used for a cloud or a mesh" in refused.err
    assert not (tmp_path / "page.html").exists()


def test_the_page_on_a_mesh_shows_it(data: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    assert run_cli("report", data / "meshes" / "ball.ply", "--out", page).code == 0
    assert page.read_text().count("data:image/png;base64,") == 1


@pytest.mark.parametrize("name", ["nothing.h5", "notes.txt.gz"])
def test_what_there_is_no_page_on_is_refused(tmp_path: Path, name: str) -> None:
    if name.endswith("gz"):
        (tmp_path / name).write_bytes(b"words")
    result = run_cli("report", tmp_path / name)
    assert result.code == 2
    assert name in result.err
    assert not list(tmp_path.glob("*.html"))
