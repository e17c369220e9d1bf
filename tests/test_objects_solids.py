"""Solids against their closed forms, and the splitting of edges."""

from __future__ import annotations

import numpy as np
import pytest
from manifold3d import CrossSection, Manifold

from pointsdf_cli.geometry.volume import enclosed_volume
from pointsdf_cli.objects.finish import (
    UnusableShape,
    closed_surface_problem,
    stand,
    to_arrays,
    weld,
)
from pointsdf_cli.objects.refine import refine, split_long_edges
from pointsdf_cli.objects.sections import polygon, rounded, stroke
from pointsdf_cli.objects.solids import (
    bevelled,
    cylinder,
    loft_sections,
    rounded_box,
    star_solid,
    tube,
    turn,
)
from pointsdf_cli.objects.walls import cavity, shell


def test_box_without_rounding_has_its_exact_volume() -> None:
    assert rounded_box((0.1, 0.06, 0.2)).volume() == pytest.approx(0.1 * 0.06 * 0.2, rel=1e-6)


def test_rounded_box_loses_what_its_edges_and_corners_lose() -> None:
    x, y, z, r = 0.1, 0.06, 0.2, 0.01
    inner = np.array([x, y, z]) - 2 * r
    faces = 2 * r * (inner[0] * inner[1] + inner[1] * inner[2] + inner[0] * inner[2])
    exact = inner.prod() + faces + np.pi * r**2 * inner.sum() + 4 / 3 * np.pi * r**3
    assert rounded_box((x, y, z), r, segments=64).volume() == pytest.approx(exact, rel=2e-3)


def test_cylinder_tends_to_pi_r_squared_h() -> None:
    exact = np.pi * 0.03**2 * 0.1
    assert cylinder(0.03, 0.1, segments=400).volume() == pytest.approx(exact, rel=1e-4)


def test_cone_is_a_third_of_its_cylinder() -> None:
    cone = turn(np.array([(0, 0), (0.04, 0), (0, 0.09)]), segments=400)
    assert cone.volume() == pytest.approx(np.pi * 0.04**2 * 0.09 / 3, rel=1e-4)


def test_closed_tube_is_a_torus_by_pappus() -> None:
    angle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    circle = 0.05 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    torus = tube(circle, 0.012, closed=True, corners=200)
    assert torus.volume() == pytest.approx(2 * np.pi**2 * 0.05 * 0.012**2, rel=1e-3)
    assert torus.genus() == 1


def test_open_tube_is_a_capsule() -> None:
    path = np.linspace((0, 0, 0), (0.1, 0, 0), 5)
    capsule = tube(path, 0.01, corners=200)
    exact = np.pi * 0.01**2 * 0.1 + 4 / 3 * np.pi * 0.01**3
    assert capsule.volume() == pytest.approx(exact, rel=0.01)
    assert capsule.bounding_box()[0] < -0.009


def test_loft_of_equal_ellipses_is_an_elliptic_cylinder() -> None:
    z = np.linspace(0, 0.1, 4)
    solid = loft_sections(z, np.full(4, 0.03), np.full(4, 0.02), corners=400)
    assert solid.volume() == pytest.approx(np.pi * 0.03 * 0.02 * 0.1, rel=1e-4)


def test_star_solid_of_constant_radius_is_a_ball() -> None:
    ball = star_solid(lambda direction: np.full(len(direction), 0.04), segments=160)
    assert ball.volume() == pytest.approx(4 / 3 * np.pi * 0.04**3, rel=2e-3)


def test_bevelled_plate_keeps_its_hole_and_nearly_its_volume() -> None:
    outline = polygon(np.array([(0, 0), (0.1, 0), (0.1, 0.05), (0, 0.05)]))
    outline -= CrossSection.circle(0.01, 64).translate((0.05, 0.025))
    square = bevelled(outline, 0.01)
    assert square.volume() == pytest.approx(outline.area() * 0.01, rel=1e-5)
    soft = bevelled(outline, 0.01, 0.002)
    assert soft.genus() == square.genus() == 1
    # A quarter-round edge of radius b takes (1 − π/4) b² off a cross-section at each edge.
    length = 2 * (0.1 + 0.05) + 2 * np.pi * 0.01
    exact = square.volume() - 2 * length * (1 - np.pi / 4) * 0.002**2
    assert soft.volume() == pytest.approx(exact, rel=0.01)


def test_bevel_that_does_not_fit_is_given_up() -> None:
    thin = stroke(np.array([(0, 0), (0.05, 0)]), 0.0008)
    plate = bevelled(thin, 0.01, 0.004)
    assert plate.volume() <= thin.area() * 0.01 * 1.0001
    assert plate.genus() == 0


def test_rounding_a_square_takes_off_its_corners() -> None:
    square = CrossSection.square((0.1, 0.1))
    exact = 0.1**2 - (4 - np.pi) * 0.01**2
    assert rounded(square, 0.01).area() == pytest.approx(exact, rel=2e-3)


def test_shell_and_cavity_share_no_volume_and_fill_the_vessel() -> None:
    line = np.array([(0, 0), (0.03, 0), (0.04, 0.08)])
    wall, room = shell(line, 0.003), cavity(line, 0.003)
    assert (wall ^ room).volume() == pytest.approx(0.0, abs=1e-12)
    # Pappus: each straight piece of the wall sweeps thickness × length × 2π × mean radius.
    side = np.hypot(0.01, 0.08)
    swept = 0.003 * (np.pi * 0.03**2 + 2 * np.pi * 0.035 * side)
    assert wall.volume() == pytest.approx(swept, rel=0.03)


def test_refine_shortens_edges_and_moves_nothing() -> None:
    box = rounded_box((0.1, 0.06, 0.2), 0.004)
    fine = refine(box, 0.02)
    assert fine.volume() == pytest.approx(box.volume(), rel=1e-9)
    assert fine.surface_area() == pytest.approx(box.surface_area(), rel=1e-9)
    mesh = fine.to_mesh()
    corners = np.asarray(mesh.vert_properties)[np.asarray(mesh.tri_verts)]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 0.02 * 1.0001
    assert refine(box, 1.0) is box


def test_splitting_one_long_edge_keeps_the_mesh_closed() -> None:
    # A tetrahedron with one vertex far away: three long edges, three short ones.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, 5.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    split_vertices, split_faces = split_long_edges(vertices, faces, 2.0)
    assert closed_surface_problem(split_vertices, split_faces) == ""
    assert enclosed_volume(split_vertices, split_faces) == pytest.approx(5 / 6)


def test_volume_of_a_tetrahedron_has_the_sign_of_its_faces() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert enclosed_volume(vertices, faces) == pytest.approx(1 / 6)
    assert enclosed_volume(vertices, faces[:, ::-1]) == pytest.approx(-1 / 6)


def test_weld_joins_equal_vertices_and_drops_collapsed_faces() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 1]], dtype=np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 4], [2, 0, 3], [3, 4, 2], [4, 3, 1]])
    joined, kept = weld(vertices, faces)
    assert len(joined) == 4
    assert len(kept) == 4
    assert closed_surface_problem(joined, kept) == ""


@pytest.mark.parametrize(
    ("solid", "words"),
    [
        (Manifold(), "empty True"),
        (Manifold.cube((1, 1, 1)) + Manifold.cube((1, 1, 1)).translate((3, 0, 0)), "one piece"),
        (Manifold.sphere(1.0) - Manifold.sphere(0.5), "one piece"),
        (Manifold.cube((1e-4, 1e-4, 1e-4)), "no volume"),
    ],
    ids=["empty", "two bodies", "buried void", "dust"],
)
def test_unusable_solids_are_refused(solid: Manifold, words: str) -> None:
    with pytest.raises(UnusableShape, match=words):
        to_arrays(solid)


def test_open_surface_is_named() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3]])
    assert "not shared by two faces" in closed_surface_problem(vertices, faces)


def test_standing_puts_the_base_on_the_table() -> None:
    box = stand(Manifold.cube((1, 2, 3)).translate((5, 6, 7)))
    assert box.bounding_box() == pytest.approx((-0.5, -1, 0, 0.5, 1, 3))
