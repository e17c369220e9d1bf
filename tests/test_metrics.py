"""Table I's metrics on shapes whose values are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pointsdf_cli.errors import InputError
from pointsdf_cli.geometry.metrics import Shape, compare, failure, iou

SAMPLES = 20_000
# Of a share p counted with n points in a box that the union fills to the part f: √(p(1−p)/(f n)).
THREE_SIGMA = 3 * np.sqrt(0.25 / (0.4 * SAMPLES))


def shape_of(mesh: trimesh.Trimesh, seed: int = 0) -> Shape:
    return Shape(mesh.vertices, mesh.faces, np.random.default_rng(seed), SAMPLES)


def ball(radius: float, at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    mesh.apply_translation(at)
    return mesh


def box(extents: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> Shape:
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation(at)
    return shape_of(mesh)


RNG = np.random.default_rng(7)


def test_concentric_balls() -> None:
    outer, inner = shape_of(ball(0.10)), shape_of(ball(0.09), seed=1)
    score = compare(inner, outer, np.random.default_rng(2), SAMPLES)
    assert score.iou == pytest.approx(0.9**3, abs=THREE_SIGMA)
    # The nearest of n samples lies a little aside of the nearest point: at most √(d² + A/n).
    assert score.chamfer == pytest.approx(0.01, rel=0.01)
    assert score.normals == pytest.approx(1.0, abs=2e-3)
    assert not score.failed


@pytest.mark.parametrize("shift", [0.02, 0.05])
def test_shifted_boxes(shift: float) -> None:
    """Along x, of an edge a: the overlap is (a − s)/(a + s) of the union."""
    score = iou(
        box((0.1, 0.08, 0.06), (shift, 0, 0)),
        box((0.1, 0.08, 0.06)),
        np.random.default_rng(0),
        SAMPLES,
    )
    assert score == pytest.approx((0.1 - shift) / (0.1 + shift), abs=THREE_SIGMA)


def test_parallel_slabs() -> None:
    """Two wide thin slabs face to face: distance and normals by hand.

    Slabs 0.2 × 0.2 × 0.002, the second 0.01 higher. Of each slab's area nearly all lies on two
    large faces, whose nearest points on the other slab are 0.008 and 0.010 away.
    """
    low, high = box((0.2, 0.2, 0.002)), box((0.2, 0.2, 0.002), (0, 0, 0.01))
    score = compare(low, high, np.random.default_rng(0), SAMPLES)
    assert score.chamfer == pytest.approx(0.009, rel=0.02)
    assert score.normals > 0.95
    assert score.iou == 0


def test_crossed_normals() -> None:
    """A slab seen from the side: the normals of the large faces are at right angles."""
    flat = box((0.2, 0.2, 0.001))
    upright = box((0.2, 0.001, 0.2))
    assert compare(flat, upright, np.random.default_rng(0), SAMPLES).normals < 0.1


def test_the_same_shape_scores_full_marks() -> None:
    mesh = trimesh.creation.torus(0.05, 0.02, major_sections=64, minor_sections=32)
    score = compare(shape_of(mesh, 0), shape_of(mesh, 1), np.random.default_rng(2), SAMPLES)
    assert score.iou == 1
    # Two draws of n points on an area A: a mean nearest distance of ½·√(A/n).
    assert score.chamfer == pytest.approx(0.5 * np.sqrt(mesh.area / SAMPLES), rel=0.05)
    assert score.normals > 0.99


def test_apart_scores_nothing_and_the_distance_between() -> None:
    left, right = shape_of(ball(0.01)), shape_of(ball(0.01, (1.0, 0, 0)))
    score = compare(left, right, np.random.default_rng(0), SAMPLES)
    assert score.iou == 0
    assert score.chamfer == pytest.approx(0.99, abs=0.006)  # mean over the ball: 0.98 to 1.00


def test_hollow_counts_as_hollow() -> None:
    """A shell against the full ball: the ratio of the volumes."""
    outer, inner = ball(0.1), ball(0.08)
    inner.invert()
    shell = trimesh.util.concatenate([outer, inner])
    score = iou(shape_of(shell), shape_of(outer), np.random.default_rng(0), SAMPLES)
    assert score == pytest.approx(1 - 0.8**3, abs=THREE_SIGMA)


def test_score_does_not_depend_on_the_side() -> None:
    one, other = shape_of(ball(0.1)), box((0.15, 0.15, 0.15))
    forth = compare(one, other, np.random.default_rng(0), SAMPLES)
    back = compare(other, one, np.random.default_rng(0), SAMPLES)
    assert (forth.iou, forth.chamfer, forth.normals) == pytest.approx(
        (back.iou, back.chamfer, back.normals)
    )


def test_failure_is_the_worst_score() -> None:
    truth = box((0.03, 0.04, 0.12))
    score = failure(truth.diagonal)
    assert (score.iou, score.normals, score.failed) == (0, 0, True)
    assert score.chamfer == pytest.approx(0.13)


def test_an_empty_mesh_is_refused() -> None:
    with pytest.raises(InputError, match="empty"):
        Shape(np.zeros((0, 3)), np.zeros((0, 3), int), np.random.default_rng(0))


def test_a_mesh_without_area_is_refused() -> None:
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    for vertices, faces in ((line, [[0, 1, 2]]), (line, np.empty((0, 3), int))):
        with pytest.raises(InputError, match="empty mesh"):
            Shape(vertices, faces, np.random.default_rng(0))
