"""Objects as files: the same whoever makes them; resumed, sharded, never replaced unasked."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from pointsdf_cli.errors import InputError
from pointsdf_cli.io.atomic import TEMPORARY_MARK
from pointsdf_cli.io.meshes import load_mesh
from pointsdf_cli.io.object_mesh import read_object_about, write_object_mesh
from pointsdf_cli.objects.generate import make_object
from pointsdf_cli.objects.store import MANIFEST, make_objects, write_manifest

QUICK = ["banana", "lemon", "wood_block", "carton"]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Twelve objects made in one go by one process."""
    folder = tmp_path_factory.mktemp("whole")
    make_objects(folder, 12, seed=5, families=QUICK)
    return contents(folder)


def test_file_holds_the_object_and_its_description(tmp_path: Path) -> None:
    make_objects(tmp_path, 3, seed=5, families=["mug"])
    made = make_object(5, 2, ["mug"])
    assert load_mesh(tmp_path / "00002_mug.ply").repair == "none"
    mesh = trimesh.load_mesh(tmp_path / "00002_mug.ply", process=False)
    assert np.array_equal(mesh.vertices, made.vertices)
    assert np.array_equal(mesh.faces, made.faces)
    about = read_object_about(tmp_path / "00002_mug.ply")
    assert about is not None
    assert about["parameters"] == made.parameters
    assert about["extent"] == pytest.approx(np.ptp(made.vertices, axis=0), abs=1e-6)


def test_manifest_lists_every_object(whole: dict[str, bytes]) -> None:
    rows = list(csv.DictReader(whole[MANIFEST].decode().splitlines()))
    assert [row["name"] + ".ply" for row in rows] == sorted(set(whole) - {MANIFEST})
    for row in rows:
        assert 0 < float(row["volume_m3"]) < 0.35**3
        assert json.loads(row["parameters"])
        assert row["family"] in QUICK


def test_two_jobs_make_what_one_makes(tmp_path: Path, whole: dict[str, bytes]) -> None:
    make_objects(tmp_path, 12, seed=5, families=QUICK, jobs=2)
    assert contents(tmp_path) == whole


def test_shards_together_make_the_whole(tmp_path: Path, whole: dict[str, bytes]) -> None:
    first = make_objects(tmp_path, 12, seed=5, families=QUICK, shard="0/2")
    second = make_objects(tmp_path, 12, seed=5, families=QUICK, shard="1/2")
    assert len(first.made) == len(second.made) == 6
    assert contents(tmp_path) == whole


def test_more_objects_leave_the_first_ones_alone(tmp_path: Path, whole: dict[str, bytes]) -> None:
    make_objects(tmp_path, 4, seed=5, families=QUICK)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.ply")}
    report = make_objects(tmp_path, 12, seed=5, families=QUICK)
    assert len(report.kept) == 4
    assert len(report.made) == 8
    assert contents(tmp_path) == whole
    assert all(path.stat().st_mtime_ns == time_ns for path, time_ns in before.items())


def test_killed_run_leaves_whole_files_and_resumes(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pointsdf_cli.cli.main", "objects", "make", "--out", tmp_path]
    command += ["--count", "150", "--seed", "5", "--jobs", "1", "--quiet"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    while process.poll() is None and len(list(tmp_path.glob("[0-9]*.ply"))) < 20:
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    found = sorted(tmp_path.glob("[0-9]*.ply"))
    assert 20 <= len(found) < 150
    assert all(read_object_about(path) for path in found)
    count = len(found) + 1
    report = make_objects(tmp_path, count, seed=5)
    assert len(report.kept) == len(found)
    assert not [path for path in tmp_path.iterdir() if TEMPORARY_MARK in path.name]
    last = make_object(5, len(found) - 1)
    mesh = trimesh.load_mesh(tmp_path / f"{last.name}.ply", process=False)
    assert np.array_equal(mesh.vertices, last.vertices)


def test_object_of_another_seed_is_not_replaced_unasked(tmp_path: Path) -> None:
    make_objects(tmp_path, 2, seed=1, families=["lemon"])
    before = contents(tmp_path)
    with pytest.raises(InputError, match="seed: 1 there, 2 now"):
        make_objects(tmp_path, 2, seed=2, families=["lemon"])
    assert contents(tmp_path) == before
    make_objects(tmp_path, 2, seed=2, families=["lemon"], force=True)
    assert contents(tmp_path) != before


@pytest.mark.parametrize("cut", [0, 40, -1], ids=["empty", "in the header", "in the body"])
def test_foreign_or_cut_file_is_not_replaced_unasked(tmp_path: Path, cut: int) -> None:
    make_objects(tmp_path, 1, seed=1, families=["lemon"])
    path = tmp_path / "00000_lemon.ply"
    whole = path.read_bytes()
    path.write_bytes(whole[:cut])
    assert read_object_about(path) is None
    with pytest.raises(InputError, match="not a complete generated object"):
        make_objects(tmp_path, 1, seed=1, families=["lemon"])
    make_objects(tmp_path, 1, seed=1, families=["lemon"], force=True)
    assert path.read_bytes() == whole


def test_description_survives_the_header(tmp_path: Path) -> None:
    about = {"text": 'Zürich\n"quoted"', "number": 0.1, "list": [1, 2], "true": True}
    vertices = np.eye(4, 3, dtype=np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    write_object_mesh(tmp_path / "a.ply", vertices, faces, about)
    assert read_object_about(tmp_path / "a.ply") == about


def test_make_reports_and_draws_a_sheet(tmp_path: Path, cli: Callable) -> None:  # type: ignore[type-arg]
    out, sheet = tmp_path / "meshes", tmp_path / "pictures" / "sheet.png"
    arguments = ["objects", "make", "--out", out, "--count", 3, "--families", "ball,lemon"]
    result = cli(*arguments, "--jobs", 1, "--sheet", sheet, "--json")
    assert result.code == 0, result.err
    values = json.loads(result.out)
    assert values["made"] == 3
    assert set(values["families"]) <= {"ball", "lemon"}
    with Image.open(sheet) as picture:
        assert picture.size[0] > 600
    again = cli(*arguments, "--jobs", 1, "--json")
    assert json.loads(again.out)["kept"] == 3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--count", "-1"], "-1 objects"),
        (["--count", "0"], "0 objects"),
        (["--count", "10000000000"], "1 to 10000000"),
        (["--count", "3", "--families", "bowll"], "--families bowl"),
        (["--count", "3", "--families", ""], "--families: an argument is empty"),
        (["--count", "3", "--seed", "-4"], "--seed"),
        (["--count", "3", "--jobs", "-2"], "--jobs"),
        (["--count", "3", "--shard", "2/2"], "--shard"),
        (["--count", "3", "--sheet", "sheet.jpeg"], ".png"),
    ],
)
def test_bad_input_is_one_message_and_no_file(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    cli: Callable,  # type: ignore[type-arg]
) -> None:
    result = cli("objects", "make", "--out", tmp_path / "out", *arguments)
    assert result.code == 2
    assert words in result.err
    assert "Traceback" not in result.err
    assert not list(tmp_path.glob("out/*"))


def test_out_that_is_a_file_is_refused(tmp_path: Path, cli: Callable) -> None:  # type: ignore[type-arg]
    (tmp_path / "out").write_text("mine")
    result = cli("objects", "make", "--out", tmp_path / "out", "--count", 2)
    assert result.code == 2
    assert "folder" in result.err
    assert (tmp_path / "out").read_text() == "mine"


def test_another_seed_does_not_mix_a_second_series_in(tmp_path: Path) -> None:
    make_objects(tmp_path, 3, seed=0)
    before = contents(tmp_path)
    with pytest.raises(InputError, match="of another seed or other families"):
        make_objects(tmp_path, 3, seed=1)
    assert contents(tmp_path) == before
    make_objects(tmp_path, 3, seed=1, force=True)
    assert len(list(tmp_path.glob("*.ply"))) == 3


def test_shards_of_two_seeds_do_not_mix(tmp_path: Path) -> None:
    make_objects(tmp_path, 4, seed=0, shard="0/2")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InputError, match="of another seed"):
        make_objects(tmp_path, 4, seed=1, shard="1/2")
    assert sorted(tmp_path.iterdir()) == before


def test_a_negative_seed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="seed is -1"):
        make_objects(tmp_path, 1, seed=-1)


def test_what_another_shard_is_writing_is_not_listed(tmp_path: Path) -> None:
    make_objects(tmp_path, 1, seed=1, families=["lemon"])
    whole = (tmp_path / "00000_lemon.ply").read_bytes()
    (tmp_path / ".00001_lemon.partial-0-1-2.ply").write_bytes(whole)
    assert len(write_manifest(tmp_path).read_text().splitlines()) == 2
