"""Meshes from files: closed, in metres, with what was mended on record."""

from __future__ import annotations

import os
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.repair import close_mesh
from pointsdf_cli.geometry.volume import enclosed_volume
from pointsdf_cli.io.input_files import largest_input
from pointsdf_cli.io.meshes import artifact_path, find_meshes, load_mesh, save_mesh


def test_a_closed_mesh_is_kept_as_it_is(tmp_path: Path, box_mesh: trimesh.Trimesh) -> None:
    box_mesh.export(tmp_path / "box.ply")
    mesh = load_mesh(tmp_path / "box.ply")
    assert mesh.repair == "none"
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(0.08 * 0.06 * 0.04)


@pytest.mark.skipif(sys.platform != "linux", reason="names are any bytes on Linux only")
def test_a_name_that_is_not_utf8_is_one_bad_mesh(tmp_path: Path, box_mesh: trimesh.Trimesh) -> None:
    box_mesh.export(tmp_path / "box.ply")
    odd = tmp_path / os.fsdecode(b"bad\xff.ply")
    (tmp_path / "box.ply").rename(odd)
    with pytest.raises(InputError, match="not UTF-8"):
        load_mesh(odd)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".off", ".glb"])
def test_every_format_gives_the_same_solid(
    suffix: str, tmp_path: Path, box_mesh: trimesh.Trimesh
) -> None:
    box_mesh.export(tmp_path / f"box{suffix}")
    mesh = load_mesh(tmp_path / f"box{suffix}")
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(1.92e-4, rel=1e-5)


def test_a_scene_of_two_parts_is_joined_at_their_places(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box((0.1, 0.1, 0.1)))
    shift = trimesh.transformations.translation_matrix([0.3, 0, 0])
    scene.add_geometry(trimesh.creation.box((0.1, 0.1, 0.1)), transform=shift)
    scene.export(tmp_path / "two.glb")
    mesh = load_mesh(tmp_path / "two.glb")
    assert mesh.size == pytest.approx(0.4)
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(2e-3, rel=1e-5)


def test_overlapping_boxes_become_one_body(tmp_path: Path) -> None:
    one = trimesh.creation.box((0.1, 0.1, 0.1))
    other = one.copy().apply_translation([0.05, 0, 0])
    trimesh.util.concatenate([one, other]).export(tmp_path / "cross.ply")
    mesh = load_mesh(tmp_path / "cross.ply")
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(1.5e-3, rel=1e-5)
    assert "united" in mesh.repair


def test_a_hollow_ball_keeps_its_cavity(tmp_path: Path) -> None:
    shell = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    hole = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
    expected = shell.volume - hole.volume
    hole.invert()
    trimesh.util.concatenate([shell, hole]).export(tmp_path / "hollow.ply")
    mesh = load_mesh(tmp_path / "hollow.ply")
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(expected, rel=1e-4)


def test_an_inside_out_mesh_is_turned(tmp_path: Path, box_mesh: trimesh.Trimesh) -> None:
    box_mesh.invert()
    box_mesh.export(tmp_path / "box.ply")
    mesh = load_mesh(tmp_path / "box.ply")
    assert enclosed_volume(mesh.vertices, mesh.faces) > 0


def test_what_lies_in_a_cavity_is_kept() -> None:
    """A ball with a cavity, in it a smaller ball with a cavity of its own."""
    balls = [trimesh.creation.icosphere(3, radius) for radius in (1.0, 0.8, 0.5, 0.3)]
    for hollow in balls[1::2]:
        hollow.invert()
    expected = sum(ball.volume for ball in balls)
    soup = trimesh.util.concatenate(balls)
    closed = close_mesh(soup.vertices, soup.faces)
    assert enclosed_volume(closed.vertices, closed.faces) == pytest.approx(expected, rel=1e-6)
    assert closed.repair == "2 pieces united"


@pytest.mark.parametrize(
    ("shift", "size", "expected"),
    [
        pytest.param(0.3, 0.1, 2e-3, id="apart"),
        pytest.param(0.09, 0.1, 1.9e-3, id="overlapping"),
        pytest.param(0.3, 0.2, 9e-3, id="the larger one"),
    ],
)
def test_a_part_turned_inside_out_is_no_cavity(
    tmp_path: Path, shift: float, size: float, expected: float
) -> None:
    one = trimesh.creation.box((0.1, 0.1, 0.1))
    other = trimesh.creation.box((size, size, size)).apply_translation([shift, 0, 0])
    other.invert()
    trimesh.util.concatenate([one, other]).export(tmp_path / "two.ply")
    mesh = load_mesh(tmp_path / "two.ply")
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(expected, rel=1e-5)
    assert "turned outward" in mesh.repair


def test_a_hollow_that_breaks_through_the_top_is_open(tmp_path: Path) -> None:
    body = trimesh.creation.box((0.1, 0.1, 0.1))
    hollow = trimesh.creation.box((0.08, 0.08, 0.1)).apply_translation([0, 0, 0.01])
    hollow.invert()
    trimesh.util.concatenate([body, hollow]).export(tmp_path / "open.ply")
    mesh = load_mesh(tmp_path / "open.ply")
    expected = 1e-3 - 0.08 * 0.08 * 0.09
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(expected, rel=1e-5)
    assert mesh.repair == "none"


def _hollow_ball() -> trimesh.Trimesh:
    outer, inner = (trimesh.creation.icosphere(3, radius) for radius in (0.1, 0.09))
    inner.invert()
    return trimesh.util.concatenate([outer, inner])


def test_a_doubled_face_or_a_hole_does_not_fill_a_cavity() -> None:
    ball = _hollow_ball()
    true = enclosed_volume(ball.vertices, ball.faces)
    # A vertex split in two: the last face has a copy of its first corner.
    split = np.vstack([ball.vertices, ball.vertices[ball.faces[-1, :1]]])
    last = [len(ball.vertices), *ball.faces[-1, 1:]]
    for vertices, faces, repair in (
        (ball.vertices, np.vstack([ball.faces, ball.faces[:1]]), "vertices merged"),
        (split, np.vstack([ball.faces[:-1], [last]]), "vertices merged"),
        (ball.vertices, ball.faces[1:], "holes filled"),
    ):
        closed = close_mesh(vertices, faces)
        assert closed.repair == repair
        assert enclosed_volume(closed.vertices, closed.faces) == pytest.approx(true, rel=1e-3)


def test_a_soup_with_doubled_faces_keeps_its_shape() -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    soup = np.concatenate([box.triangles, box.triangles[:3]]).reshape(-1, 3)
    closed = close_mesh(soup, np.arange(len(soup)).reshape(-1, 3))
    assert closed.repair == "vertices merged"
    assert enclosed_volume(closed.vertices, closed.faces) == pytest.approx(1e-3, rel=1e-6)


def test_a_body_that_nearly_fills_its_cavity_is_kept() -> None:
    shell, core = _hollow_ball(), trimesh.creation.icosphere(3, 0.085)
    both = trimesh.util.concatenate([shell, core])
    closed = close_mesh(both.vertices, both.faces)
    true = enclosed_volume(both.vertices, both.faces)
    assert enclosed_volume(closed.vertices, closed.faces) == pytest.approx(true, rel=1e-5)


def test_a_missing_triangle_is_filled_and_recorded(
    tmp_path: Path, box_mesh: trimesh.Trimesh
) -> None:
    trimesh.Trimesh(box_mesh.vertices, box_mesh.faces[1:]).export(tmp_path / "box.ply")
    mesh = load_mesh(tmp_path / "box.ply")
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(1.92e-4, rel=1e-5)
    assert mesh.repair == "holes filled"


def test_a_soup_without_a_lid_is_re_meshed_from_winding_numbers(tmp_path: Path) -> None:
    # A cylinder whose faces share no vertex, without its top cap, and with one face doubled.
    body = trimesh.creation.cylinder(radius=0.03, height=0.1, sections=48)
    kept = body.faces[body.triangles_center[:, 2] < 0.0499]
    soup = np.concatenate([body.vertices[kept], body.vertices[kept[:1]]]).reshape(-1, 3)
    trimesh.Trimesh(soup, np.arange(len(soup)).reshape(-1, 3), process=False).export(
        tmp_path / "can.stl"
    )
    mesh = load_mesh(tmp_path / "can.stl")
    assert "winding" in mesh.repair or "filled" in mesh.repair
    assert enclosed_volume(mesh.vertices, mesh.faces) == pytest.approx(body.volume, rel=0.15)
    assert mesh.size == pytest.approx(0.1, abs=0.005)


def test_millimetres_are_named_and_may_be_declared(
    tmp_path: Path, box_mesh: trimesh.Trimesh
) -> None:
    box_mesh.apply_scale(1000).export(tmp_path / "box.ply")
    with pytest.raises(InputError, match="--unit mm"):
        load_mesh(tmp_path / "box.ply")
    assert load_mesh(tmp_path / "box.ply", unit="mm").size == pytest.approx(0.08)


def test_a_vertex_that_no_face_uses_is_no_part_of_the_size(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.01, 0.01, 0.01))
    box.apply_translation((3.0, 0.0, 0.0))
    vertices = np.vstack([box.vertices, [[0.0, 0.0, 0.0]]])
    closed = close_mesh(vertices, np.asarray(box.faces))
    np.testing.assert_allclose(np.ptp(closed.vertices, axis=0), 0.01, atol=1e-6)


def test_a_mesh_far_from_its_origin_keeps_its_shape_or_is_refused(
    tmp_path: Path, box_mesh: trimesh.Trimesh
) -> None:
    for away, name in ((50.0, "far.obj"), (1000.0, "farther.obj")):
        moved = box_mesh.copy()
        moved.apply_translation([away, 0, 0])
        moved.export(tmp_path / name, digits=12)
    found = load_mesh(tmp_path / "far.obj")
    corners = np.sort(found.vertices - [50.0, 0, 0], axis=0)
    np.testing.assert_allclose(corners, np.sort(box_mesh.vertices, axis=0), atol=4e-6)
    with pytest.raises(InputError, match="lies 1000 m away"):
        load_mesh(tmp_path / "farther.obj")


def test_an_archive_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.3mf", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", bytes(largest_input("mesh") + 1))
    with pytest.raises(InputError, match="unpacks to"):
        load_mesh(tmp_path / "a.3mf")


def test_a_sheet_encloses_nothing_and_is_refused(tmp_path: Path) -> None:
    trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]]).export(tmp_path / "s.ply")
    with pytest.raises(InputError, match="encloses no volume"):
        load_mesh(tmp_path / "s.ply")


def test_meshes_are_found_below_and_keep_their_places(tmp_path: Path, box_mesh) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    box_mesh.export(tmp_path / "a" / "b" / "box.stl")
    (found,) = find_meshes(tmp_path)
    assert artifact_path(found, tmp_path, Path("out")) == Path("out/a/b/box.h5")


def test_two_meshes_of_one_name_are_refused_unless_a_pattern_chooses(
    tmp_path: Path, box_mesh: trimesh.Trimesh
) -> None:
    box_mesh.export(tmp_path / "box.stl")
    box_mesh.export(tmp_path / "box.ply")
    with pytest.raises(InputError, match="--pattern"):
        find_meshes(tmp_path)
    assert [p.name for p in find_meshes(tmp_path, "*.ply")] == ["box.ply"]


def test_saving_and_loading_goes_round(tmp_path: Path, box_mesh: trimesh.Trimesh) -> None:
    save_mesh(tmp_path / "deep" / "box.ply", box_mesh.vertices, box_mesh.faces)
    assert load_mesh(tmp_path / "deep" / "box.ply").size == pytest.approx(0.08)


def test_real_scans_load_closed(shared_meshes: Path) -> None:
    for name in ("006_mustard_bottle", "024_bowl", "065-a_cups"):
        mesh = load_mesh(shared_meshes / "test" / "ycb" / f"{name}.ply")
        assert trimesh.Trimesh(mesh.vertices, mesh.faces).is_watertight
        assert 0.03 < mesh.size < 0.35


def test_hidden_files_are_no_meshes(tmp_path: Path, box_mesh: trimesh.Trimesh) -> None:
    for place in ("mug.ply", "._mug.ply", ".archives/tmp1/cup.ply", "below/pan.ply"):
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        box_mesh.export(tmp_path / place)
    assert [path.name for path in find_meshes(tmp_path)] == ["pan.ply", "mug.ply"]


@pytest.mark.parametrize("pattern", ["**.ply", "/tmp/*.ply", ""])
def test_a_wrong_pattern_is_one_message(
    tmp_path: Path, box_mesh: trimesh.Trimesh, pattern: str
) -> None:
    box_mesh.export(tmp_path / "box.ply")
    with pytest.raises(InputError, match="pattern"):
        find_meshes(tmp_path, pattern)


def test_a_gltf_in_several_files_is_told_to_come_as_one(tmp_path: Path, box_mesh: Any) -> None:
    for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(box_mesh)).items():
        (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError) as refused:
        load_mesh(tmp_path / "model.gltf")
    assert ".glb" in refused.value.message


def test_a_collada_file_is_in_its_own_unit(tmp_path: Path) -> None:
    data = trimesh.creation.box((60.0, 10.0, 20.0)).export(file_type="dae")
    path = tmp_path / "finger.dae"
    path.write_bytes(data.replace(b"<asset>", b'<asset><unit name="millimeter" meter="0.001"/>', 1))
    vertices = load_mesh(path).vertices
    np.testing.assert_allclose(np.sort(np.ptp(vertices, axis=0)), [0.01, 0.02, 0.06], atol=1e-6)
