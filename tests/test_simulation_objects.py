"""Convex pieces, mass, and how things stand, against shapes whose answers are known by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold, Mesh64, OpType

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.frames import apply_transform
from pointsdf_cli.geometry.stable_poses import (
    draw_pose,
    stable_poses,
    tilt_margin,
)
from pointsdf_cli.io.meshes import LoadedMesh, load_mesh
from pointsdf_cli.objects.generate import make_object
from pointsdf_cli.simulation.decomposition import (
    MOST_FACES,
    VOLUME_OFF,
    convex_pieces,
    with_few_faces,
    without_details,
)
from pointsdf_cli.simulation.feet import with_flat_foot
from pointsdf_cli.simulation.mass import DENSITY
from pointsdf_cli.simulation.sim_object import prepare_object


def loaded(name: str, mesh: trimesh.Trimesh) -> LoadedMesh:
    return LoadedMesh(
        name, np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32), name, "none"
    )


def can(radius: float = 0.03, height: float = 0.12) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius, height, sections=32)


def test_convex_shape_is_one_piece_with_its_own_size(tmp_path: Path) -> None:
    pieces = convex_pieces(loaded("can", can()), cache=tmp_path)
    assert len(pieces) == 1
    assert np.ptp(pieces[0][0], axis=0) == pytest.approx([0.06, 0.06, 0.12], abs=1e-6)
    assert len(list((tmp_path / "decompositions").glob("*.npz"))) == 1


def test_a_file_in_another_unit_is_not_taken_from_the_cache(tmp_path: Path) -> None:
    can(3.0, 12.0).export(tmp_path / "can.ply")
    for unit, height in (("cm", 0.12), ("inch", 12 * 0.0254), ("cm", 0.12)):
        pieces = convex_pieces(load_mesh(tmp_path / "can.ply", unit), cache=tmp_path)
        assert np.ptp(pieces[0][0], axis=0)[2] == pytest.approx(height, rel=1e-5)


def test_ring_keeps_its_hole_and_its_volume(tmp_path: Path) -> None:
    pytest.importorskip("coacd")
    ring = loaded("ring", trimesh.creation.annulus(0.03, 0.05, 0.03))
    pieces = convex_pieces(ring, cache=tmp_path)
    assert len(pieces) >= 4
    hulls = [trimesh.Trimesh(v, f) for v, f in pieces]
    # The middle of the hole lies in no piece.
    planes = [(h.face_normals, h.triangles[:, 0]) for h in hulls]
    for normals, corners in planes:
        assert ((0 - corners) * normals).sum(axis=1).max() > 0.005
    total = sum(h.volume for h in hulls)
    assert total == pytest.approx(np.pi * (0.05**2 - 0.03**2) * 0.03, rel=0.2)


@pytest.mark.parametrize("most", [500, 3000])
def test_fewer_faces_are_the_same_can(most: int) -> None:
    # Their lids are fans of long thin triangles, which quadrics fold over.
    folded = 0
    for index in range(8):
        made = make_object(0, index, ["can"])
        mesh = trimesh.Trimesh(made.vertices, made.faces)
        few = with_few_faces(mesh, most)
        assert few.is_watertight
        assert few.volume == pytest.approx(mesh.volume, rel=VOLUME_OFF)
        assert few.extents == pytest.approx(mesh.extents, rel=0.05)
        folded += mesh.simplify_quadric_decimation(face_count=most).volume < 0.8 * mesh.volume
        if len(mesh.faces) > most:
            assert len(few.faces) < len(mesh.faces)
    assert folded, "else this test shows nothing"


def test_pieces_of_a_mesh_that_quadrics_tear_are_not_swollen(tmp_path: Path) -> None:
    # CoACD rebuilds what is not closed from voxels, some millimetres too thick.
    pytest.importorskip("coacd")
    made = make_object(0, 0, ["teapot"])
    mesh = trimesh.Trimesh(made.vertices, made.faces)
    most = MOST_FACES
    torn = mesh.simplify_quadric_decimation(face_count=most)
    assert not torn.is_watertight, "else this test shows nothing"
    simple = without_details(mesh, most)
    assert simple is not None
    assert simple.is_watertight
    assert len(simple.faces) <= most
    assert simple.volume == pytest.approx(mesh.volume, rel=VOLUME_OFF)

    pieces = convex_pieces(loaded("teapot", mesh), cache=tmp_path)
    union = Manifold.batch_boolean(
        [Manifold.hull_points(corners) for corners, _ in pieces], OpType.Add
    )
    solid = Manifold(Mesh64(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.uint64)))
    # 1.4%; 3.9% when it was rebuilt.
    assert (union - solid).volume() < 0.025 * solid.volume()


def test_an_open_mesh_has_no_simpler_closed_one() -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    ball.update_faces(np.arange(len(ball.faces)) > 5)
    assert without_details(ball, 100) is None


def test_damaged_cache_is_made_again(tmp_path: Path) -> None:
    mesh = loaded("can", can())
    first = convex_pieces(mesh, cache=tmp_path)
    (path,) = (tmp_path / "decompositions").glob("*.npz")
    path.write_bytes(path.read_bytes()[:40])
    again = convex_pieces(mesh, cache=tmp_path)
    assert np.array_equal(first[0][0], again[0][0])


def test_mass_and_inertia_are_those_of_a_solid_box(tmp_path: Path) -> None:
    sides = np.array([0.04, 0.06, 0.10])
    box = trimesh.creation.box(sides)
    box.apply_translation([0.3, 0.0, 0.1])
    item = prepare_object(loaded("box", box), tmp_path)
    mass = DENSITY * sides.prod()
    assert item.mass == pytest.approx(mass)
    expected = [(sides**2).sum() - s**2 for s in sides]
    assert sorted(item.inertia) == pytest.approx(sorted(np.array(expected) * mass / 12))
    assert item.T_mesh_body[:3, 3] == pytest.approx([0.3, 0.0, 0.1])
    assert np.linalg.det(item.T_mesh_body[:3, :3]) == pytest.approx(1.0)
    # In its own frame the piece is centred, its axes along the sides.
    assert sorted(np.ptp(item.pieces[0][0], axis=0)) == pytest.approx(sorted(sides))


def test_inside_out_is_refused(tmp_path: Path) -> None:
    box = trimesh.creation.box([0.05] * 3)
    box.invert()
    with pytest.raises(InputError, match="encloses"):
        prepare_object(loaded("inverted", box), tmp_path)


def test_box_has_six_poses_and_its_margins_are_those_of_geometry() -> None:
    box = trimesh.creation.box([0.04, 0.06, 0.10])
    poses = stable_poses(np.asarray(box.vertices), np.zeros(3))
    assert len(poses) == 6
    assert sum(pose.probability for pose in poses) == pytest.approx(1.0, abs=1e-6)
    for pose in poses:
        foot = sorted({0.04, 0.06, 0.10} - {round(pose.height, 6)})
        assert pose.margin == pytest.approx(np.arctan2(foot[0] / 2, pose.height / 2), abs=1e-6)
        placed = np.asarray(box.vertices) @ pose.T_table_object[:3, :3].T
        assert (placed + pose.T_table_object[:3, 3])[:, 2].min() == pytest.approx(0.0, abs=1e-9)


def test_a_ball_of_many_faces_stands_on_the_table_and_not_in_it() -> None:
    ball = np.asarray(trimesh.creation.icosphere(4, 0.15).vertices)  # its hull is simplified
    for pose in stable_poses(ball, np.zeros(3))[:5]:
        heights = apply_transform(pose.T_table_object, ball)[:, 2]
        assert heights.min() == pytest.approx(0, abs=1e-9)
        assert pose.height == pytest.approx(heights.max(), abs=1e-9)


def test_a_centre_of_mass_outside_is_refused() -> None:
    """A surface that crosses itself can have it there, and would be looked at for ever."""
    box = trimesh.creation.box([0.04, 0.06, 0.10])
    with pytest.raises(InputError, match="outside of itself"):
        stable_poses(np.asarray(box.vertices), np.array([0.0, 0.0, 0.2]))


def test_cans_are_drawn_standing_and_needles_lying() -> None:
    rng = np.random.default_rng(0)
    poses = stable_poses(np.asarray(can().vertices), np.zeros(3))
    drawn = [draw_pose(poses, 1.0, rng) for _ in range(50)]
    assert all(stands and poses[i].height == pytest.approx(0.12) for i, stands in drawn)
    # A pencil upright falls at a touch: it is never stood up.
    pencil = stable_poses(np.asarray(can(0.004, 0.15).vertices), np.zeros(3))
    for _ in range(50):
        index, stands = draw_pose(pencil, 1.0, rng)
        assert not stands or pencil[index].height < 0.02


def test_without_preference_poses_follow_their_probability() -> None:
    rng = np.random.default_rng(1)
    box = trimesh.creation.box([0.02, 0.06, 0.10])
    poses = stable_poses(np.asarray(box.vertices), np.zeros(3))
    drawn = [draw_pose(poses, 0.0, rng)[0] for _ in range(3000)]
    shares = np.bincount(drawn, minlength=len(poses)) / 3000
    assert shares == pytest.approx([pose.probability for pose in poses], abs=0.03)


def test_a_hull_that_lost_the_foot_of_its_can_stands_again() -> None:
    """Of the bottom's rim three corners are left, on one side: the can would fall over at once."""
    mesh = can(0.037, 0.25)
    pose = max(stable_poses(mesh.vertices, np.zeros(3)), key=lambda pose: pose.height)
    vertices = np.asarray(mesh.vertices)
    above = vertices @ pose.T_table_object[2, :3] + pose.T_table_object[2, 3]
    bottom = np.flatnonzero(above < 0.01)
    one_side = bottom[np.argsort(vertices[bottom, 0])[:3]]
    left = np.concatenate([vertices[above > 0.2], vertices[one_side]])
    fallen = trimesh.convex.convex_hull(left)
    ((corners, _),) = with_flat_foot([(fallen.vertices, fallen.faces)], vertices, pose)
    placed = corners @ pose.T_table_object[:3, :3].T + pose.T_table_object[:3, 3]
    mass = pose.T_table_object[:3, 3]
    assert tilt_margin(fallen.vertices @ pose.T_table_object[:3, :3].T + mass, mass) == 0.0
    assert tilt_margin(placed, mass) == pytest.approx(np.arctan2(0.037, 0.125), abs=0.01)
    assert placed[:, 2].min() == pytest.approx(0.0, abs=1e-9)


def test_what_is_nearly_foot_is_put_flat_and_the_rest_stays() -> None:
    mesh = can(0.037, 0.25)
    pose = max(stable_poses(mesh.vertices, np.zeros(3)), key=lambda pose: pose.height)
    rng = np.random.default_rng(0)
    vertices = np.array(mesh.vertices)
    above = vertices @ pose.T_table_object[2, :3] + pose.T_table_object[2, 3]
    rough = (
        vertices
        + np.where(above < 0.01, rng.uniform(0, 0.003, len(vertices)), 0.0)[:, None]
        * (pose.T_table_object[2, :3])
    )
    hull = trimesh.convex.convex_hull(rough)
    ((corners, _),) = with_flat_foot([(hull.vertices, hull.faces)], vertices, pose)
    height = corners @ pose.T_table_object[2, :3] + pose.T_table_object[2, 3]
    low = height[height < 0.1]
    assert np.abs(low).max() < 1e-9
    assert height.max() == pytest.approx(0.25, abs=1e-9)
    assert np.linalg.norm(corners[:, :2], axis=1).max() == pytest.approx(0.037, abs=1e-9)
