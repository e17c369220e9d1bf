"""`info`, `doctor`, `report`: what they print and write about real artifacts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import run_cli


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


@pytest.mark.parametrize("folder", ["missing", "empty"])
def test_a_report_on_nothing_is_an_input_error(folder: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    result = run_cli("report", tmp_path / folder)
    assert result.code == 2
    assert not list((tmp_path / "empty").iterdir())
