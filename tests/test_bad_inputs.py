"""What users get wrong: each mistake is one message and exit code 2, and leaves no file behind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import trimesh
from conftest import run_cli

BOX = trimesh.creation.box((0.08, 0.06, 0.04))


def write_box(folder: Path, name: str = "box.ply", scale: float = 1.0) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    BOX.copy().apply_scale(scale).export(folder / name)
    return folder / name


def mesh_text(text: str | bytes, name: str) -> Callable[[Path], list[object]]:
    """`render` of one mesh file with the given contents."""

    def make(folder: Path) -> list[object]:
        path = folder / name
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return ["render", "--meshes", path, "--out", folder / "out"]

    return make


def render_with(*options: object) -> Callable[[Path], list[object]]:
    """`render` of a good mesh with a bad option."""

    def make(folder: Path) -> list[object]:
        write_box(folder / "m")
        return ["render", "--meshes", folder / "m", "--out", folder / "out", *options]

    return make


def camera_with(contents: object) -> Callable[[Path], list[object]]:
    """`render` through a camera file."""

    def make(folder: Path) -> list[object]:
        (folder / "K.json").write_text(
            contents if isinstance(contents, str) else json.dumps(contents)
        )
        return render_with("--camera", folder / "K.json")(folder)

    return make


def label_with(
    spoil: Callable[[Path, Path], None], *options: object
) -> Callable[[Path], list[object]]:
    """`label-sdf` of good views and meshes after `spoil(views file, mesh file)`."""

    def make(folder: Path) -> list[object]:
        mesh = write_box(folder / "m")
        run_cli("render", "--meshes", folder / "m", "--out", folder / "v", "--views", 2, "-q")
        spoil(folder / "v" / "box.h5", mesh)
        return [
            "label-sdf", "--views", folder / "v", "--meshes", folder / "m", "--out",
            folder / "out", "--points", 500, *options,
        ]  # fmt: skip

    return make


def nothing(_views: Path, _mesh: Path) -> None:
    pass


def set_attribute(name: str, value: object) -> Callable[[Path, Path], None]:
    def spoil(views: Path, _mesh: Path) -> None:
        with h5py.File(views, "a") as file:
            file.attrs[name] = value

    return spoil


def drop_attribute(name: str) -> Callable[[Path, Path], None]:
    def spoil(views: Path, _mesh: Path) -> None:
        with h5py.File(views, "a") as file:
            del file.attrs[name]

    return spoil


def truncate(views: Path, _mesh: Path) -> None:
    views.write_bytes(views.read_bytes()[:700])


def empty(views: Path, _mesh: Path) -> None:
    views.write_bytes(b"")


def rubbish(views: Path, _mesh: Path) -> None:
    views.write_bytes(os.urandom(4096))


def nan_ply() -> bytes:
    mesh = BOX.copy()
    mesh.vertices = np.array(mesh.vertices) * np.nan
    return trimesh.exchange.ply.export_ply(mesh, encoding="ascii")


def command(*arguments: object) -> Callable[[Path], list[object]]:
    def make(folder: Path) -> list[object]:
        return [
            folder / a[1:] if isinstance(a, str) and a.startswith("@") else a for a in arguments
        ]

    return make


def setup_then(
    prepare: Callable[[Path], object], *arguments: object
) -> Callable[[Path], list[object]]:
    def make(folder: Path) -> list[object]:
        prepare(folder)
        return command(*arguments)(folder)

    return make


def read_only(folder: Path) -> None:
    write_box(folder / "m")
    (folder / "file").write_text("a file where a folder is needed")


K = [[550, 0, 320], [0, 550, 240], [0, 0, 1]]
OBJ = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\n"
MISTAKES: dict[str, tuple[Callable[[Path], list[object]], str]] = {
    # --- meshes -----------------------------------------------------------------------------
    "no such folder": (command("render", "--meshes", "@none"), "no such folder"),
    "empty folder": (
        setup_then(lambda f: (f / "e").mkdir(), "render", "--meshes", "@e", "--out", "@out"),
        "holds no meshes",
    ),
    "pattern without a match": (render_with("--pattern", "*.stl"), "match *.stl"),
    "a text file as mesh": (mesh_text("hello", "a.txt"), "is not a mesh file"),
    "an empty OBJ": (mesh_text("", "a.obj"), "a.obj"),
    "a truncated OBJ": (mesh_text(OBJ + "f 1 2", "a.obj"), "a.obj"),
    "an OBJ with words for numbers": (mesh_text("v a b c\nf 1 2 3\n", "a.obj"), "a.obj"),
    "an OBJ whose faces name no vertex": (mesh_text(OBJ + "f 1 2 9\n", "a.obj"), "a.obj"),
    "an OBJ of points only": (mesh_text(OBJ, "a.obj"), "a.obj"),
    "an empty PLY": (mesh_text("", "a.ply"), "a.ply"),
    "a PLY of rubbish": (mesh_text(b"ply\nformat binary\n\xff\x00", "a.ply"), "a.ply"),
    "a PLY cut short": (mesh_text(BOX.export(file_type="ply")[:400], "a.ply"), "a.ply"),
    "a PLY of NaN": (mesh_text(nan_ply(), "a.ply"), "NaN"),
    "an empty STL": (mesh_text("", "a.stl"), "a.stl"),
    "an STL cut short": (mesh_text(BOX.export(file_type="stl")[:200], "a.stl"), "a.stl"),
    "a GLB of rubbish": (mesh_text(b"glTF\x02\x00\x00\x00", "a.glb"), "a.glb"),
    "an OFF of words": (mesh_text("OFF\nnot numbers\n", "a.off"), "a.off"),
    "a mesh without area": (
        mesh_text("v 0 0 0\nv 0.1 0 0\nv 0.2 0 0\nf 1 2 3\n", "a.obj"), "encloses no volume"),
    "a flat mesh": (
        mesh_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n", "a.obj"), "encloses no volume"),
    "a mesh that is one point": (mesh_text("v 0 0 0\nf 1 1 1\n", "a.obj"), "across"),
    "a mesh in millimetres": (
        setup_then(lambda f: write_box(f / "m", scale=1000), "render", "--meshes", "@m"),
        "--unit mm",
    ),
    "a mesh in centimetres": (
        setup_then(lambda f: write_box(f / "m", scale=100), "render", "--meshes", "@m"), "--unit"),
    "a mesh in kilometres": (
        setup_then(lambda f: write_box(f / "m", scale=1e-3), "render", "--meshes", "@m"), "across"),
    "a folder named like a mesh": (
        setup_then(lambda f: (f / "m" / "a.ply").mkdir(parents=True), "render", "--meshes", "@m"),
        "is a folder",
    ),
    "two meshes of one name": (
        setup_then(
            lambda f: (write_box(f / "m"), write_box(f / "m", "b.stl").rename(f / "m/box.stl")),
            "render", "--meshes", "@m",
        ),
        "two meshes of one name",
    ),
    # --- options of render ------------------------------------------------------------------
    "no --meshes": (command("render"), "--meshes"),
    "views 0": (render_with("--views", 0), "--views"),
    "views -5": (render_with("--views", -5), "--views"),
    "views many": (render_with("--views", 10**9), "--views"),
    "views of words": (render_with("--views", "many"), "--views"),
    "distance 0": (render_with("--distance", 0), "--distance"),
    "distance NaN": (render_with("--distance", "nan"), "--distance"),
    "distance inside the object": (render_with("--distance", 0.01), "--distance"),
    "distance beyond sight": (render_with("--distance", 19), "saw fewer than"),
    "noise negative": (render_with("--noise", -0.001), "--noise"),
    "noise NaN": (render_with("--noise", "nan"), "--noise"),
    "noise in millimetres": (render_with("--noise", 1), "--noise"),
    "unknown unit": (render_with("--unit", "furlong"), "--unit: no unit 'furlong'"),
    "wrong unit": (render_with("--unit", "mm"), "across"),
    "jobs negative": (render_with("--jobs", -1), "--jobs"),
    "jobs absurd": (render_with("--jobs", 10**6), "--jobs"),
    "seed negative": (render_with("--seed", -1), "--seed"),
    "seed of words": (render_with("--seed", "x"), "--seed"),
    "shard beyond the last": (render_with("--shard", "2/2"), "--shard"),
    "shard of words": (render_with("--shard", "first"), "--shard"),
    "unknown option": (render_with("--vews", 3), "No such option"),
    "unknown command": (command("rendr"), "No such command"),
    "unknown camera": (render_with("--camera", "kinect9"), "no such intrinsics"),
    "missing camera file": (render_with("--camera", "none.json"), "no such intrinsics"),
    # --- camera files -----------------------------------------------------------------------
    "a camera file that is no JSON": (camera_with("{"), "is not readable JSON"),
    "a camera file without K": (camera_with({"width": 1, "height": 1}), "has no intrinsics"),
    "K of eight numbers": (
        camera_with({"K": [1] * 8, "width": 640, "height": 480}), "has no intrinsics"),
    "K with NaN": (
        camera_with('{"K": [[NaN,0,1],[0,1,1],[0,0,1]], "width": 640, "height": 480}'), "NaN"),
    "K with a focal length of 0": (
        camera_with({"K": [[0, 0, 1], [0, 1, 1], [0, 0, 1]], "width": 640, "height": 480}),
        "K holds",
    ),
    "K transposed": (
        camera_with({"K": np.transpose(K).tolist(), "width": 640, "height": 480}), "skew"),
    "an image of no width": (camera_with({"K": K, "width": 0, "height": 480}), "width is 0"),
    "an image of negative height": (
        camera_with({"K": K, "width": 640, "height": -1}), "height is -1"),
    "an image width in words": (
        camera_with({"K": K, "width": "wide", "height": 480}), "width or height of 'wide'"),
    # --- places to write --------------------------------------------------------------------
    "out is a file": (
        setup_then(read_only, "render", "--meshes", "@m", "--out", "@file"), "is a file"),
    "out below a file": (
        setup_then(read_only, "render", "--meshes", "@m", "--out", "@file/deeper"), "file"),
    "out cannot be made": (
        setup_then(read_only, "render", "--meshes", "@m", "--out", "/proc/rgrasp"), "/proc/rgrasp"),
    # --- label-sdf --------------------------------------------------------------------------
    "no views": (
        command("label-sdf", "--views", "@v", "--meshes", "@m", "--out", "@out"),
        "no such folder of views",
    ),
    "points 0": (label_with(nothing, "--points", 0), "--points"),
    "points negative": (label_with(nothing, "--points", -1), "--points"),
    "views cut short": (label_with(truncate), "cut short"),
    "views empty": (label_with(empty), "cut short"),
    "views of rubbish": (label_with(rubbish), "cut short"),
    "an HDF5 of another schema": (label_with(set_attribute("schema", "grasps")), "holds grasps"),
    "an HDF5 without a schema": (label_with(drop_attribute("schema")), "no rgrasp artifact"),
    "an older schema version": (label_with(set_attribute("schema_version", 0)), "older version"),
    "a newer schema version": (label_with(set_attribute("schema_version", 99)), "another version"),
    "a version in words": (label_with(set_attribute("schema_version", "one")), "version"),
    "the mesh is gone": (
        label_with(lambda _, mesh: mesh.rename(mesh.with_name("x.ply"))), "no mesh box"),
    "the mesh has changed": (
        label_with(lambda _, mesh: trimesh.creation.box((0.1, 0.1, 0.1)).export(mesh)),
        "not the mesh",
    ),
    # --- info -------------------------------------------------------------------------------
    "info of nothing": (command("info", "@none.h5"), "no such file"),
    "info of a folder": (setup_then(read_only, "info", "@m"), "no kind that rgrasp knows"),
    "info of a text file": (setup_then(read_only, "info", "@file"), "no kind that rgrasp knows"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_message_and_leaves_nothing(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    make, expected = MISTAKES[name]
    arguments = make(tmp_path)
    before = {p for p in tmp_path.rglob("*") if p.is_file()}
    result = run_cli(*arguments)
    assert result.code == 2, result
    assert expected in result.err
    assert "Traceback" not in result.err
    assert result.out == ""
    assert len(result.err.splitlines()) <= 8, result.err
    assert {p for p in tmp_path.rglob("*") if p.is_file()} == before


def test_at_least_sixty_mistakes_are_tried() -> None:
    assert len(MISTAKES) >= 60


@pytest.mark.skipif(sys.platform != "linux", reason="limits file sizes through prlimit")
def test_a_full_disk_is_one_message_and_leaves_nothing(tmp_path: Path) -> None:
    # A limit on file size fails a write as a full disk does, without filling one. Python ignores
    # SIGXFSZ, so the write itself answers with an error.
    write_box(tmp_path / "m")
    run = subprocess.run(
        [sys.executable, "-c", (
            "import resource, sys\n"
            "resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))\n"
            "sys.argv = 'rgrasp render --meshes m --out out --views 40 --jobs 1'.split()\n"
            "from pointsdf_cli.cli.main import main\n"
            "main()\n"
        )],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 2, run.stderr
    assert "Traceback" not in run.stderr
    assert "out/box.h5" in run.stderr
    assert not [p for p in (tmp_path / "out").rglob("*") if p.is_file()]
